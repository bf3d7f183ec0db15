//! [`Grid`]: the triangles of a surface by the cells of the map that they touch. Plain values.

use super::place::{MapFrame, Place};

/// The maximum number of cells along a side.
const MAX_SIDE: usize = 512;

/// Cells over a rectangle of the map, each with the triangles that touch it.
pub(super) struct Grid {
    rectangle: [f64; 4],
    side: usize,
    /// The first triangle of each cell in `triangles`; one more than cells.
    first: Vec<u32>,
    triangles: Vec<u32>,
    /// The shorter side of a cell, metres.
    cell_m: f64,
}

impl Grid {
    pub fn new(frame: MapFrame, vertices: &[Place], triangles: &[[u32; 3]], rectangle: [f64; 4]) -> Self {
        let [west, south, east, north] = rectangle;
        let side = ((triangles.len() as f64 / 2.0).sqrt() as usize).clamp(1, MAX_SIDE);
        let farthest = if south.abs() > north.abs() { south } else { north };
        let [per_x, per_y] = frame.metres(farthest);
        let cell_m = (per_x * (east - west)).min(per_y * (north - south)) / side as f64;
        let mut grid = Self { rectangle, side, first: vec![0; side * side + 1], triangles: Vec::new(), cell_m };
        let touched = |t: &[u32; 3]| {
            let corners = t.map(|i| &vertices[i as usize]);
            let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
            corners.iter().for_each(|corner| super::place::extend(&mut bounds, corner.at));
            if corners.iter().any(|corner| frame.is_pole(corner.at[1])) {
                (bounds[0], bounds[2]) = (west, east);
            }
            // Chords of a parallel run nearer to the pole.
            let width = bounds[2] - bounds[0];
            let bulge = if frame.is_globe() { width * width / 16.0 } else { 0.0 };
            let from = grid.cell([bounds[0], bounds[1] - bulge]);
            let to = grid.cell([bounds[2], bounds[3] + bulge]);
            (from, to)
        };
        let ranges: Vec<_> = triangles.iter().map(touched).collect();
        let cells = |([x0, y0], [x1, y1]): &([usize; 2], [usize; 2])| {
            let (x0, x1) = (*x0, *x1);
            (*y0..=*y1).flat_map(move |y| (x0..=x1).map(move |x| y * side + x))
        };
        for range in &ranges {
            cells(range).for_each(|cell| grid.first[cell + 1] += 1);
        }
        for cell in 0..side * side {
            grid.first[cell + 1] += grid.first[cell];
        }
        let mut next = grid.first.clone();
        grid.triangles = vec![0; grid.first.last().map_or(0, |count| *count as usize)];
        for (triangle, range) in ranges.iter().enumerate() {
            for cell in cells(range) {
                grid.triangles[next[cell] as usize] = triangle as u32;
                next[cell] += 1;
            }
        }
        grid
    }

    /// Returns the column and row of the nearest cell.
    fn cell(&self, [x, y]: [f64; 2]) -> [usize; 2] {
        let [west, south, east, north] = self.rectangle;
        let number = |value: f64, low: f64, high: f64| {
            let share = (value - low) / (high - low);
            // A conversion of NaN, where there is no extent, is 0.
            ((share * self.side as f64) as usize).min(self.side - 1)
        };
        [number(x, west, east), number(y, south, north)]
    }

    fn of_cell(&self, x: usize, y: usize) -> &[u32] {
        let cell = y * self.side + x;
        &self.triangles[self.first[cell] as usize..self.first[cell + 1] as usize]
    }

    /// Returns the triangles at a place of the map.
    pub fn at(&self, at: [f64; 2]) -> &[u32] {
        let [x, y] = self.cell(at);
        self.of_cell(x, y)
    }

    /// Visits the triangles of cells in rings around a place, with a distance in metres that all of them have at least, until
    /// `visit` returns false.
    pub fn around(&self, at: [f64; 2], mut visit: impl FnMut(&[u32], f64) -> bool) {
        let [x, y] = self.cell(at).map(|number| number as i64);
        let last = self.side as i64 - 1;
        for ring in 0..=last {
            let beyond_m = (ring - 1).max(0) as f64 * self.cell_m;
            let is_inside = |value: i64| (0..=last).contains(&value);
            for j in (y - ring..=y + ring).filter(|j| is_inside(*j)) {
                let is_whole_row = (j - y).abs() == ring;
                let step = if is_whole_row { 1 } else { (2 * ring).max(1) as usize };
                for i in (x - ring..=x + ring).step_by(step).filter(|i| is_inside(*i)) {
                    if !visit(self.of_cell(i as usize, j as usize), beyond_m) {
                        return;
                    }
                }
            }
        }
    }
}
