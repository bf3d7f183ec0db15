//! Measures the vertical distance between a tile's triangles and the finest samples, in metres.
//!
//! The triangles of a cell share the diagonal from south-west to north-east. The distances include the bulge of the earth above
//! flat triangles, which is metres where vertices lie kilometres apart.

use terrane::math::Ellipsoid;

use crate::Extent;
use crate::pyramid::grid::Grid;
use crate::pyramid::samples::{Samples, Window};
use crate::pyramid::tile::{CELLS, TileKey};

/// A cell of a tile: its corner in columns and rows of the finest lattice, and its side in cells of that lattice.
#[derive(Clone, Copy)]
pub(super) struct Cell {
    pub first: [i64; 2],
    pub stride: i64,
    /// Heights in metres: south-west, south-east, north-west, north-east.
    pub corners: [f64; 4],
}

impl Cell {
    /// Returns the largest distance between the cell's triangles and the finest samples in a window. Samples without data do not
    /// count.
    pub fn error_m(&self, bulge: &Bulge, finest: &Samples, window: &Window) -> f64 {
        let [sw, se, nw, ne] = self.corners;
        let [east, north] = bulge.at(0.25 * (sw + se + nw + ne));
        let step = 1.0 / self.stride as f64;
        let own = Window { first: self.first, last: self.first.map(|c| c + self.stride) };
        let Some(part) = own.intersection(window) else { return 0.0 };
        let mut error_m = 0.0f64;
        for y in part.first[1]..=part.last[1] {
            let b = y - self.first[1];
            let v = b as f64 * step;
            let row = &finest.row_from(part.first[0], y)[..part.width()];
            let first = part.first[0] - self.first[0];
            // The first sample of the south-eastern triangle in this row.
            let split = (b - first).clamp(0, row.len() as i64) as usize;
            let bulge = north * v * (1.0 - v);
            let upper = farthest(&row[..split], first, step, [sw + v * (nw - sw) - bulge, ne - nw, east]);
            let lower =
                farthest(&row[split..], first + split as i64, step, [sw + v * (ne - se) - bulge, se - sw, east]);
            error_m = error_m.max(upper).max(lower);
        }
        error_m
    }

    /// Returns the distance between the triangles and a height at a position in the cell, 0..1 from west and from south.
    pub fn distance_m(&self, bulge: &Bulge, [u, v]: [f64; 2], height_m: f64) -> f64 {
        let [sw, se, nw, ne] = self.corners;
        let surface = if u >= v { sw + u * (se - sw) + v * (ne - se) } else { sw + v * (nw - sw) + u * (ne - nw) };
        let [east, north] = bulge.at(height_m);
        (surface - east * u * (1.0 - u) - north * v * (1.0 - v) - height_m).abs()
    }
}

/// Returns the largest vertical distance in metres between the grid of a tile and the samples of a finer tile inside. `set` is
/// the rectangle of the set on an ellipsoid; `height_m` returns the height of a vertex of the coarser tile by its column and
/// row.
pub(crate) fn distance_to_finer_m(
    ellipsoid: &Ellipsoid,
    set: &Extent,
    key: TileKey,
    height_m: impl Fn(i64, i64) -> f32,
    finer: TileKey,
    samples: &Samples,
) -> f64 {
    let side = CELLS as i64;
    let (stride, cells) = (1i64 << (finer.level - key.level), side << finer.level);
    let [x, y] = [finer.x, finer.y].map(|c| i64::from(c) * side);
    let window = Window { first: [x, y], last: [x + side, y + side] };
    let [left, low] = [key.x, key.y].map(|c| i64::from(c) * side);
    let along = (side / stride).max(1);
    let mut distance_m = 0.0f64;
    for row in y / stride..y / stride + along {
        let bulge = Bulge::new(ellipsoid, set, cells, row * stride, stride);
        for column in x / stride..x / stride + along {
            let (i, j) = (column - left, row - low);
            let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(di, dj)| f64::from(height_m(i + di, j + dj)));
            let cell = Cell { first: [column * stride, row * stride], stride, corners };
            distance_m = distance_m.max(cell.error_m(&bulge, samples, &window));
        }
    }
    distance_m
}

/// Returns the largest distance between samples of a row and a surface: `start + slope * u - east * u * (1 - u)`, where `u` of
/// the k-th sample is `(first + k) * step`. Samples without data do not count.
#[inline(always)]
fn farthest(row: &[f32], first: i64, step: f64, [start, slope, east]: [f64; 3]) -> f64 {
    let distance = |at: f64, h: f32| {
        let u = at * step;
        (start + u * slope - east * u * (1.0 - u) - f64::from(h)).abs()
    };
    let (fours, rest) = row.as_chunks::<4>();
    let mut at = [0.0, 1.0, 2.0, 3.0].map(|k| first as f64 + k);
    let mut far = [0.0f64; 4];
    for four in fours {
        for lane in 0..4 {
            far[lane] = larger(distance(at[lane], four[lane]), far[lane]);
            at[lane] += 4.0;
        }
    }
    let far = far.into_iter().fold(0.0, |most, own| larger(own, most));
    rest.iter().enumerate().fold(far, |most, (k, h)| larger(distance(at[0] + k as f64, *h), most))
}

/// Returns the larger one of two distances: the second one if the first is NaN.
#[inline(always)]
fn larger(distance: f64, most: f64) -> f64 {
    if distance > most { distance } else { most }
}

/// A row of neighbouring cells of a tile. Distances are those of [`Cell`], bit for bit: a tile is measured in parts as well.
pub(super) struct CellRow<'a> {
    /// The heights of the southern and of the northern corners, one more than cells.
    pub corners: [&'a [f32]; 2],
    /// The first column and row, in columns and rows of the finest lattice.
    pub first: [i64; 2],
    pub stride: i64,
    /// True for the northernmost row of a tile, which has the samples on its northern edge.
    pub is_last: bool,
}

/// From this side on, cells are measured one by one, and below it all cells of a row together.
const WIDE_STRIDE: i64 = 8;

impl CellRow<'_> {
    /// Returns the largest distance between the triangles of the cells and the finest samples, those on the eastern edge of the
    /// last cell included.
    #[inline(always)]
    pub fn error_m(&self, bulge: &Bulge, finest: &Samples, rises: &mut Vec<[f64; 2]>) -> f64 {
        let [south, north] = self.corners;
        let (step, stride) = (1.0 / self.stride as f64, self.stride as usize);
        let corners = |x: usize| [south[x], south[x + 1], north[x], north[x + 1]].map(f64::from);
        let cells = south.len() - 1;
        rises.clear();
        rises.extend((0..cells).map(|x| {
            let [sw, se, nw, ne] = corners(x);
            bulge.at(0.25 * (sw + se + nw + ne))
        }));
        let mut error_m = 0.0f64;
        for b in 0..self.stride + i64::from(self.is_last) {
            let row = &finest.row_from(self.first[0], self.first[1] + b)[..cells * stride + 1];
            let v = b as f64 * step;
            // The surfaces of the upper and of the lower triangle of a cell.
            let upper = |x: usize| {
                let ([sw, _, nw, ne], [east, north]) = (corners(x), rises[x]);
                [sw + v * (nw - sw) - north * v * (1.0 - v), ne - nw, east]
            };
            let lower = |x: usize| {
                let ([sw, se, _, ne], [east, north]) = (corners(x), rises[x]);
                [sw + v * (ne - se) - north * v * (1.0 - v), se - sw, east]
            };
            // The last sample of the row lies in the lower triangle, unless the row is the northern edge.
            let split = b.min(self.stride) as usize;
            if self.stride < WIDE_STRIDE {
                let (own, _) = row.split_at(cells * stride);
                for k in 0..stride {
                    let u = k as f64 * step;
                    let at = |[start, slope, east]: [f64; 3]| start + u * slope - east * u * (1.0 - u);
                    let mut far = [0.0f64; 4];
                    for x in 0..cells {
                        let surface = if k < split { at(upper(x)) } else { at(lower(x)) };
                        let distance = (surface - f64::from(own[x * stride + k])).abs();
                        far[x % 4] = larger(distance, far[x % 4]);
                    }
                    error_m = far.into_iter().fold(error_m, |most, own| larger(own, most));
                }
            } else {
                for x in 0..cells {
                    let own = &row[x * stride..(x + 1) * stride];
                    let of_upper = farthest(&own[..split], 0, step, upper(x));
                    let of_lower = farthest(&own[split..], split as i64, step, lower(x));
                    error_m = larger(of_lower, larger(of_upper, error_m));
                }
            }
            let last = farthest(&row[cells * stride..], self.stride, step, lower(cells - 1));
            error_m = larger(last, error_m);
        }
        error_m
    }
}

/// How far the earth rises above chords through the cells of a row.
#[derive(Clone, Copy)]
pub(super) struct Bulge {
    /// The radii of curvature in metres, from west to east and from south to north.
    radii_m: [f64; 2],
    /// Half the square of the angles of a cell.
    half_squares: [f64; 2],
}

impl Bulge {
    /// Returns the bulge over cells of `stride` finest cells whose southern edge is the row `j` of the finest lattice.
    pub fn of_row(grid: &Grid<'_>, j: i64, stride: i64) -> Self {
        Self::new(&grid.ellipsoid, &grid.extent, grid.cells(0), j, stride)
    }

    /// Like [`Self::of_row`], for a rectangle with a number of finest cells along a side.
    fn new(ellipsoid: &Ellipsoid, e: &Extent, cells: i64, j: i64, stride: i64) -> Self {
        let (cells, side) = (cells as f64, stride as f64);
        let (d_lon, d_lat) = ((e.east - e.west) / cells * side, (e.north - e.south) / cells * side);
        let south = e.south + (e.north - e.south) * (j as f64 / cells);
        // The latitude at which the cells are widest.
        let latitude = 0f64.clamp(south.min(south + d_lat), south.max(south + d_lat));
        let east_radius = ellipsoid.prime_vertical_radius_m(latitude);
        let flatter = 1.0 - ellipsoid.eccentricity_squared() * latitude.sin().powi(2);
        let north_radius = east_radius * (1.0 - ellipsoid.eccentricity_squared()) / flatter;
        let half_squares = [latitude.cos() * d_lon, d_lat].map(|angle| 0.5 * angle * angle);
        Self { radii_m: [east_radius, north_radius], half_squares }
    }

    /// Returns the factors of t (1 - t) from west to east and from south to north at a height, in metres. Inside a triangle both
    /// terms add up; at the middle of its longest side the sum is the length squared divided by eight radii.
    pub fn at(&self, height_m: f64) -> [f64; 2] {
        [0, 1].map(|k| (self.radii_m[k] + height_m) * self.half_squares[k])
    }
}
