//! Measures the vertical distance between a tile's triangles and the finest samples, in metres.
//!
//! The triangles of a cell share the diagonal from south-west to north-east. The distances include the bulge of the earth above
//! flat triangles, which is metres where vertices lie kilometres apart.

use terrane::math::WGS84;

use crate::pyramid::grid::Grid;
use crate::pyramid::samples::{Samples, Window};

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

/// Returns the largest distance between samples of a row and a surface: `start + slope * u - east * u * (1 - u)`, where `u` of the
/// k-th sample is `(first + k) * step`.
fn farthest(row: &[f32], first: i64, step: f64, [start, slope, east]: [f64; 3]) -> f64 {
    let mut farthest = 0.0f64;
    for (k, h) in row.iter().enumerate() {
        let u = (first + k as i64) as f64 * step;
        let distance = (start + u * slope - east * u * (1.0 - u) - f64::from(*h)).abs();
        // The comparison is false for samples without data.
        if distance > farthest {
            farthest = distance;
        }
    }
    farthest
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
        let (e, cells) = (grid.extent, grid.cells(0) as f64);
        let side = stride as f64;
        let (d_lon, d_lat) = ((e.east - e.west) / cells * side, (e.north - e.south) / cells * side);
        let south = e.south + (e.north - e.south) * (j as f64 / cells);
        // The latitude at which the cells are widest.
        let latitude = 0f64.clamp(south.min(south + d_lat), south.max(south + d_lat));
        let east_radius = WGS84.prime_vertical_radius_m(latitude);
        let flatter = 1.0 - WGS84.eccentricity_squared() * latitude.sin().powi(2);
        let north_radius = east_radius * (1.0 - WGS84.eccentricity_squared()) / flatter;
        let half_squares = [latitude.cos() * d_lon, d_lat].map(|angle| 0.5 * angle * angle);
        Self { radii_m: [east_radius, north_radius], half_squares }
    }

    /// Returns the factors of t (1 - t) from west to east and from south to north at a height, in metres. Inside a triangle both
    /// terms add up; at the middle of its longest side the sum is the length squared divided by eight radii.
    pub fn at(&self, height_m: f64) -> [f64; 2] {
        [0, 1].map(|k| (self.radii_m[k] + height_m) * self.half_squares[k])
    }
}
