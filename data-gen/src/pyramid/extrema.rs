//! The extrema of a source that are nearest to vertices of the grid.

use super::samples::Window;

/// Vertices of coarser lattices lie so far apart that it is quicker to look for extrema at each than between them.
const MAX_STRIP_DEPTH: u32 = 6;

/// Divides a window of the lattice of a depth into windows of the finest lattice with all its vertices: bands of rows of the
/// finest lattice, strips along rows or along a column of others, and single vertices that lie far apart.
pub(super) fn parts(depth: u32, window: &Window) -> Vec<Window> {
    let Window { first, last } = *window;
    let rows = first[1]..=last[1];
    let fine =
        |first: [i64; 2], last: [i64; 2]| Window { first: first.map(|c| c << depth), last: last.map(|c| c << depth) };
    if depth == 0 {
        rows.step_by(64).map(|y| fine([first[0], y], [last[0], (y + 63).min(last[1])])).collect()
    } else if depth > MAX_STRIP_DEPTH {
        rows.flat_map(|y| (first[0]..=last[0]).map(move |x| [x, y])).map(|at| fine(at, at)).collect()
    } else if first[0] == last[0] {
        vec![fine(first, last)]
    } else {
        rows.map(|y| fine([first[0], y], [last[0], y])).collect()
    }
}

/// An extremum of the source and the vertex that is nearest to it.
#[derive(Clone, Copy)]
pub(super) struct Extremum {
    pub at: [i64; 2],
    /// The square of its distance from the vertex, in cells.
    far: f64,
    /// Its longitude and latitude in radians.
    place: [f64; 2],
    pub height_m: f32,
}

/// The extrema nearest to the vertices of a window, one for each.
pub(super) struct Extrema {
    window: Window,
    pub found: Vec<Extremum>,
    /// For each vertex the number of its extremum, from 1 on; 0 without one.
    numbers: Vec<u32>,
}

impl Extrema {
    pub fn new(window: Window) -> Self {
        Self { window, found: Vec::new(), numbers: vec![0; window.width() * window.height()] }
    }

    /// Adds an extremum by its column and row. Of several at a vertex the nearest one counts, and of those the first by its
    /// place.
    pub fn add(&mut self, [x, y]: [f64; 2], place: [f64; 2], height_m: f32) {
        let (at, Window { first, last }) = ([x, y].map(|c| c.round() as i64), self.window);
        if !(0..2).all(|k| (first[k]..=last[k]).contains(&at[k])) {
            return;
        }
        let new = Extremum { at, far: (x - at[0] as f64).powi(2) + (y - at[1] as f64).powi(2), place, height_m };
        let number = &mut self.numbers[(at[1] - first[1]) as usize * self.window.width() + (at[0] - first[0]) as usize];
        if *number == 0 {
            self.found.push(new);
            *number = self.found.len() as u32;
            return;
        }
        let old = &mut self.found[*number as usize - 1];
        let by_place = || new.place[0].total_cmp(&old.place[0]).then(new.place[1].total_cmp(&old.place[1]));
        if new.far.total_cmp(&old.far).then_with(by_place).is_lt() {
            *old = new;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_all_vertices_of_a_window_once() {
        for depth in [0, 1, 3, MAX_STRIP_DEPTH, MAX_STRIP_DEPTH + 1] {
            for (first, last) in [([3, 4], [3, 90]), ([0, 70], [40, 70]), ([1, 1], [9, 7]), ([2, 2], [2, 2])] {
                let parts = parts(depth, &Window { first, last });
                for at in (first[1]..=last[1]).flat_map(|y| (first[0]..=last[0]).map(move |x| [x, y])) {
                    let at = at.map(|c| c << depth);
                    let holds = |part: &&Window| part.contains(&Window { first: at, last: at });
                    assert_eq!(parts.iter().filter(holds).count(), 1, "{depth} {at:?}");
                }
            }
        }
    }
}
