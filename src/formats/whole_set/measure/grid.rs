//! [`Grid`]: the triangles of a surface by the cells of the map that they touch. Plain values.

use super::place::{MapFrame, Place};

/// The margin around a triangle as a share of its size: more than twice the share that [`super::surface`] adds to one.
const MARGIN: f64 = 4e-3;
/// The maximum number of cells along a side.
const MAX_SIDE: usize = 512;

/// Cells over a rectangle of the map, each with the triangles that touch it.
pub(super) struct Grid {
    /// The smallest x and y on the map.
    origin: [f64; 2],
    /// The cells of one along x and along y.
    cells_per: [f64; 2],
    side: usize,
    /// The first triangle of each cell in `triangles`; one more than cells.
    first: Vec<u32>,
    triangles: Vec<u32>,
    /// The smallest x and y of each triangle on the map, then the largest, with a margin for rounding.
    bounds: Vec<[f64; 4]>,
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
        let (first, bounds) = (vec![0; side * side + 1], Vec::with_capacity(triangles.len()));
        let (origin, cells_per) = ([west, south], [east - west, north - south].map(|length| side as f64 / length));
        let mut grid = Self { origin, cells_per, side, first, triangles: Vec::new(), bounds, cell_m };
        let touched = |grid: &mut Self, t: &[u32; 3]| {
            let corners = t.map(|i| &vertices[i as usize]);
            let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
            corners.iter().for_each(|corner| super::place::extend(&mut bounds, corner.at));
            let has_pole = corners.iter().any(|corner| frame.is_pole(corner.at[1]));
            if has_pole {
                (bounds[0], bounds[2]) = (west, east);
            }
            // Chords of a parallel run nearer to the pole.
            let [width, height] = [bounds[2] - bounds[0], bounds[3] - bounds[1]];
            let bulge = if frame.is_globe() { width * width / 16.0 } else { 0.0 };
            let [from, to] = [[bounds[0], bounds[1] - bulge], [bounds[2], bounds[3] + bulge]].map(|at| grid.cell(at));
            // A pole has every longitude.
            let dx = if has_pole { f64::INFINITY } else { MARGIN * width };
            let dy = MARGIN * height + bulge;
            grid.bounds.push([bounds[0] - dx, bounds[1] - dy, bounds[2] + dx, bounds[3] + dy]);
            (from, to)
        };
        let ranges: Vec<_> = triangles.iter().map(|triangle| touched(&mut grid, triangle)).collect();
        let cells = |&([x0, y0], [x1, y1]): &([usize; 2], [usize; 2])| {
            (y0..=y1).flat_map(move |y| (x0..=x1).map(move |x| y * side + x))
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
    fn cell(&self, at: [f64; 2]) -> [usize; 2] {
        // A conversion of NaN, where there is no extent, is 0.
        [0, 1].map(|k| (((at[k] - self.origin[k]) * self.cells_per[k]) as usize).min(self.side - 1))
    }

    fn of_cell(&self, x: usize, y: usize) -> &[u32] {
        let cell = y * self.side + x;
        &self.triangles[self.first[cell] as usize..self.first[cell + 1] as usize]
    }

    /// Returns the triangles whose bounds on the map contain a point.
    pub fn at(&self, at: [f64; 2]) -> impl Iterator<Item = u32> {
        let [x, y] = self.cell(at);
        self.of_cell(x, y).iter().copied().filter(move |triangle| {
            let [west, south, east, north] = self.bounds[*triangle as usize];
            (west <= at[0]) & (at[0] <= east) & (south <= at[1]) & (at[1] <= north)
        })
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
