//! Heights for vertices without data, by the push-pull method: samples with data are averaged over larger and larger squares,
//! then interpolated bilinearly back, so that gaps continue their surroundings smoothly.
//!
//! Squares grow to a side of 64 vertices, a box. Boxes without any data take heights from a coarse lattice over the whole set.
//! So a height depends on the 3 x 3 boxes around it and on that lattice, whichever window it is computed in.

/// The vertices along a side of a box.
pub(crate) const BOX: i64 = 64;
/// The halvings from vertices to one square for a whole box.
const DEPTHS: usize = 6;

/// The averages over the squares of one box.
#[derive(Clone, Debug)]
pub(super) struct BoxMeans {
    /// Depths 1 to 6: squares of 2 to 64 vertices, row-major from the south-west. NaN marks squares without data.
    depths: [Vec<f32>; DEPTHS],
}

impl BoxMeans {
    /// Averages the vertices of a box, NaN where there is no data and beyond the edges of the set.
    pub fn new(vertices: &[f32]) -> Self {
        let mut depths: [Vec<f32>; DEPTHS] = Default::default();
        let mut side = BOX as usize;
        for depth in 0..DEPTHS {
            let finer = if depth == 0 { vertices } else { &depths[depth - 1] };
            let half = side / 2;
            let mean = |k: usize| {
                let at = 2 * (k / half) * side + 2 * (k % half);
                let (mut sum, mut count) = (0.0f64, 0);
                for h in [at, at + 1, at + side, at + side + 1].map(|at| finer[at]).into_iter().filter(|h| !h.is_nan())
                {
                    sum += f64::from(h);
                    count += 1;
                }
                if count > 0 { (sum / f64::from(count)) as f32 } else { f32::NAN }
            };
            let means = (0..half * half).map(mean).collect();
            depths[depth] = means;
            side = half;
        }
        Self { depths }
    }

    /// Returns true if no vertex of the box has data.
    pub fn is_empty(&self) -> bool {
        self.at(DEPTHS, 0, 0).is_nan()
    }

    /// Returns the average of a square of a depth from 1 to 6. Columns and rows count from the corner of the box.
    fn at(&self, depth: usize, x: usize, y: usize) -> f32 {
        self.depths[depth - 1][y * (BOX as usize >> depth) + x]
    }
}

/// The squares of one depth that a box needs along one axis: its own, and at depths from 1 on one on each side.
#[derive(Clone, Copy)]
struct Span {
    first: i64,
    last: i64,
    /// The squares along the whole set.
    squares: i64,
}

impl Span {
    fn new(box_at: i64, cells: i64, depth: usize) -> Self {
        let squares = (cells >> depth) + 1;
        let (first, last) = ((box_at * BOX) >> depth, (box_at * BOX + BOX - 1) >> depth);
        let margin = i64::from(depth > 0);
        Self { first: (first - margin).max(0), last: (last + margin).min(squares - 1), squares }
    }

    fn len(self) -> usize {
        (self.last - self.first + 1) as usize
    }

    /// Returns for each square the two squares of the next depth between whose middles its own middle lies, as indices into
    /// `coarser`, and the fraction from the first to the second.
    fn neighbours(self, coarser: Self) -> Vec<([usize; 2], f64)> {
        let neighbours = |square: i64| {
            let at = ((square as f64 - 0.5) / 2.0).clamp(0.0, (coarser.squares - 1) as f64);
            let left = at as i64;
            let right = (left + 1).min(coarser.squares - 1);
            ([left, right].map(|k| (k - coarser.first) as usize), at - left as f64)
        };
        (self.first..=self.last).map(neighbours).collect()
    }
}

/// Computes the heights of all vertices of a box as if none had data. `means` returns the averages of a box by its column and
/// row, `coarse` the height at a vertex of a lattice that has fractions. `cells` is the number of cells along the set's side.
pub(super) fn pull<'a>(
    at: [i64; 2],
    cells: i64,
    means: impl Fn(i64, i64) -> &'a BoxMeans,
    coarse: impl Fn([f64; 2]) -> f64,
) -> Vec<f32> {
    let spans = |depth: usize| at.map(|box_at| Span::new(box_at, cells, depth));
    let [columns, rows] = spans(DEPTHS);
    let boxes: Vec<&BoxMeans> = (rows.first..=rows.last)
        .flat_map(|y| (columns.first..=columns.last).map(move |x| (x, y)))
        .map(|(x, y)| means(x, y))
        .collect();
    // The mean of a square at a depth from 1 on. The column and the row count from the corner of the set.
    let own = |depth: usize, x: i64, y: i64| {
        let side = BOX >> depth;
        let of = (y / side - rows.first) as usize * columns.len() + (x / side - columns.first) as usize;
        boxes[of].at(depth, (x % side) as usize, (y % side) as usize)
    };
    let middle = |box_at: i64| (box_at * BOX) as f64 + 0.5 * (BOX - 1) as f64;
    let mut heights = Vec::with_capacity(columns.len() * rows.len());
    for y in rows.first..=rows.last {
        heights.extend((columns.first..=columns.last).map(|x| {
            let mean = own(DEPTHS, x, y);
            if mean.is_nan() { coarse([middle(x), middle(y)]) as f32 } else { mean }
        }));
    }
    for depth in (0..DEPTHS).rev() {
        let ([columns, rows], [coarser_columns, coarser_rows]) = (spans(depth), spans(depth + 1));
        let width = coarser_columns.len();
        let (across, up) = (columns.neighbours(coarser_columns), rows.neighbours(coarser_rows));
        let mut finer = Vec::with_capacity(columns.len() * rows.len());
        for (y, &(lines, fy)) in (rows.first..).zip(&up) {
            let [low, high] = lines.map(|line| &heights[line * width..][..width]);
            let start = finer.len();
            finer.extend(across.iter().map(|&([left, right], fx)| {
                let along = |line: &[f32]| f64::from(line[left]) * (1.0 - fx) + f64::from(line[right]) * fx;
                (along(low) * (1.0 - fy) + along(high) * fy) as f32
            }));
            if depth > 0 {
                for (x, height) in (columns.first..).zip(&mut finer[start..]) {
                    let mean = own(depth, x, y);
                    if !mean.is_nan() {
                        *height = mean;
                    }
                }
            }
        }
        heights = finer;
    }
    heights
}

/// Replaces NaN by the push-pull method over a whole grid. If all samples are unknown, they become 0.
pub(super) fn fill_whole(heights: &mut [f32], width: usize, height: usize) {
    if !heights.iter().any(|h| h.is_nan()) {
        return;
    }
    if width <= 1 && height <= 1 {
        heights.fill(0.0);
        return;
    }
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let mut coarse = vec![f32::NAN; w * h];
    for (j, row) in coarse.chunks_mut(w).enumerate() {
        for (i, out) in row.iter_mut().enumerate() {
            let (mut sum, mut count) = (0.0f64, 0);
            for y in 2 * j..(2 * j + 2).min(height) {
                for x in 2 * i..(2 * i + 2).min(width) {
                    let v = heights[y * width + x];
                    if !v.is_nan() {
                        sum += f64::from(v);
                        count += 1;
                    }
                }
            }
            if count > 0 {
                *out = (sum / f64::from(count)) as f32;
            }
        }
    }
    fill_whole(&mut coarse, w, h);
    for (k, out) in heights.iter_mut().enumerate().filter(|(_, h)| h.is_nan()) {
        let at = [k % width, k / width].map(|c| (c as f64 - 0.5) / 2.0);
        *out = bilinear(&coarse, [w, h], at) as f32;
    }
}

/// Interpolates a grid at a column and row, clamped to the grid.
pub(super) fn bilinear(heights: &[f32], [width, height]: [usize; 2], [x, y]: [f64; 2]) -> f64 {
    let (x, y) = (x.clamp(0.0, (width - 1) as f64), y.clamp(0.0, (height - 1) as f64));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = (x - x0 as f64, y - y0 as f64);
    let at = |x: usize, y: usize| f64::from(heights[y * width + x]);
    let low = at(x0, y0) * (1.0 - fx) + at(x1, y0) * fx;
    let high = at(x0, y1) * (1.0 - fx) + at(x1, y1) * fx;
    low * (1.0 - fy) + high * fy
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gaps of less than a box are filled as if the whole grid were filled at once.
    #[test]
    fn boxes_give_the_heights_of_the_whole_grid() {
        let side = 129usize;
        let height = |x: usize, y: usize| 100.0 + 30.0 * (0.1 * x as f32).sin() + y as f32;
        let gap = |x: usize, y: usize| (x as f32 - 60.0).hypot(y as f32 - 66.0) < 20.0 || (x > 110 && y < 9);
        let known: Vec<f32> = (0..side * side)
            .map(|k| if gap(k % side, k / side) { f32::NAN } else { height(k % side, k / side) })
            .collect();
        let mut whole = known.clone();
        fill_whole(&mut whole, side, side);
        let means: Vec<BoxMeans> = (0..9)
            .map(|b| {
                let vertex = |k: usize| [b % 3 * 64 + k % 64, b / 3 * 64 + k / 64];
                let at = |[x, y]: [usize; 2]| if x < side && y < side { known[y * side + x] } else { f32::NAN };
                BoxMeans::new(&(0..4096).map(|k| at(vertex(k))).collect::<Vec<_>>())
            })
            .collect();
        let mut compared = 0;
        for b in 0..9usize {
            let at = [b % 3, b / 3];
            let coarse = |_: [f64; 2]| panic!("each box has data");
            let filled = pull(at.map(|c| c as i64), 128, |x, y| &means[(3 * y + x) as usize], coarse);
            let wide = (side - at[0] * 64).min(64);
            for (k, h) in filled.iter().enumerate() {
                let (x, y) = (at[0] * 64 + k % wide, at[1] * 64 + k / wide);
                if known[y * side + x].is_nan() {
                    assert_eq!(*h, whole[y * side + x], "{x} {y}");
                    compared += 1;
                }
            }
        }
        assert!(compared > 1000);
    }
}
