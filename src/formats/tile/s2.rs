//! Cells of the S2 geometry as bounding volumes: the extension `3DTILES_bounding_volume_S2`. Plain values.
//!
//! S2 projects the sphere onto the six faces of a cube, divides each face as a quadtree, and numbers the cells of a level
//! along a Hilbert curve (s2geometry.io, "S2 Cells"). The latitudes of the sphere are taken for geodetic ones.

use glam::DVec3;

use crate::math::{Ellipsoid, Geodetic, OrientedBox, surface_box};

/// The number of levels below a face.
const MAX_LEVEL: u32 = 30;
/// The largest angle in radians between samples of a cell's surface, and their maximum along a side.
const SAMPLE_STEP: f64 = 1.1e-3;
const MAX_SAMPLES: u32 = 8;

/// The quarter of a cell (bit 1: upper half along i, bit 0: along j) by the orientation of the curve and its position.
const QUARTERS: [[u32; 4]; 4] = [[0, 1, 3, 2], [0, 2, 3, 1], [3, 2, 0, 1], [3, 1, 0, 2]];
/// How the orientation changes inside the quarter at a position.
const TURNS: [usize; 4] = [1, 0, 0, 3];

/// A cell: a part of a face of the cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats) struct S2Cell {
    face: u8,
    level: u32,
    /// The position in the level along the axes of the face.
    i: u32,
    j: u32,
}

impl S2Cell {
    /// Parses a token: the 64-bit id in hexadecimal without trailing zeros. Returns `None` if it is invalid.
    pub fn from_token(token: &str) -> Option<Self> {
        if token.is_empty() || token.len() > 16 || !token.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return None;
        }
        Self::from_id(u64::from_str_radix(token, 16).ok()? << (4 * (16 - token.len())))
    }

    /// Returns the cell with a 64-bit id; `None` if it is invalid.
    pub fn from_id(id: u64) -> Option<Self> {
        let face = (id >> 61) as u8;
        // The lowest set bit tells the level: two bits a level precede it.
        let below = id.trailing_zeros();
        if face > 5 || below % 2 == 1 || below > 2 * MAX_LEVEL {
            return None;
        }
        let level = MAX_LEVEL - below / 2;
        let (mut i, mut j, mut orientation) = (0, 0, usize::from(face & 1));
        for step in 0..level {
            let position = (id >> (59 - 2 * step) & 3) as usize;
            let quarter = QUARTERS[orientation][position];
            (i, j) = (2 * i + (quarter >> 1), 2 * j + (quarter & 1));
            orientation ^= TURNS[position];
        }
        Some(Self { face, level, i, j })
    }

    /// Returns the cell at a position of a level below this cell. Levels below the last of S2 are its last.
    pub fn part(&self, level: u32, x: u32, y: u32) -> Self {
        let depth = level.min(MAX_LEVEL - self.level);
        let (i, j) = ((self.i << depth) + (x >> (level - depth)), (self.j << depth) + (y >> (level - depth)));
        Self { level: self.level + depth, i, j, ..*self }
    }

    /// Returns a box around the cell between two heights above an ellipsoid, ECEF metres.
    pub fn oriented_box(&self, ellipsoid: &Ellipsoid, min_height_m: f64, max_height_m: f64) -> OrientedBox {
        let extent = std::f64::consts::FRAC_PI_2 / f64::from(self.level).exp2();
        let steps = ((extent / SAMPLE_STEP).ceil() as u32).clamp(1, MAX_SAMPLES);
        let at = |along_i: f64, along_j: f64, height_m| {
            let count = f64::from(self.level).exp2();
            let p = self.direction((f64::from(self.i) + along_i) / count, (f64::from(self.j) + along_j) / count);
            Geodetic { longitude: p.y.atan2(p.x), latitude: p.z.clamp(-1.0, 1.0).asin(), height_m }
        };
        let share = |step: u32| f64::from(step) / f64::from(steps);
        let samples = (0..=steps).flat_map(|i| (0..=steps).map(move |j| (i, j)));
        let samples =
            samples.flat_map(|(i, j)| [min_height_m, max_height_m].map(|height_m| at(share(i), share(j), height_m)));
        let center = at(0.5, 0.5, 0.5 * (min_height_m + max_height_m));
        surface_box(ellipsoid, &center, samples, extent / f64::from(steps))
    }

    /// Returns the unit vector of a point on the face, whose coordinates are from 0 to 1.
    fn direction(&self, s: f64, t: f64) -> DVec3 {
        // The quadratic projection, which makes the cells of a level about equally large.
        let project = |s: f64| match s >= 0.5 {
            true => (4.0 * s * s - 1.0) / 3.0,
            false => (1.0 - 4.0 * (1.0 - s) * (1.0 - s)) / 3.0,
        };
        let (u, v) = (project(s), project(t));
        let on_cube = match self.face {
            0 => DVec3::new(1.0, u, v),
            1 => DVec3::new(-u, 1.0, v),
            2 => DVec3::new(-u, -v, 1.0),
            3 => DVec3::new(-1.0, -v, -u),
            4 => DVec3::new(v, -1.0, -u),
            _ => DVec3::new(v, u, -1.0),
        };
        on_cube.normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::WGS84;

    #[test]
    fn tokens_are_read_as_s2_does() {
        let cell = |token: &str| S2Cell::from_token(token).map(|cell| (cell.face, cell.level, cell.i, cell.j));
        assert_eq!(cell("1"), Some((0, 0, 0, 0)));
        assert_eq!(cell("b"), Some((5, 0, 0, 0)));
        assert_eq!(cell("3"), Some((1, 0, 0, 0)));
        // The first quarter of an even face is at its lower left, that of an odd face too.
        assert_eq!(cell("04"), Some((0, 1, 0, 0)));
        assert_eq!(cell("0c"), Some((0, 1, 0, 1)));
        assert_eq!(cell("14"), Some((0, 1, 1, 1)));
        assert_eq!(cell("1c"), Some((0, 1, 1, 0)));
        assert_eq!(cell("2c"), Some((1, 1, 1, 0)));
        assert_eq!(cell("89c2594").map(|cell| (cell.0, cell.1)), Some((4, 11)));
        for bad in ["", "X", "0", "e", "f4", "2", "11111111111111111", "g1"] {
            assert_eq!(cell(bad), None, "{bad}");
        }
    }

    /// 89c25 is the well-known cell around New York.
    #[test]
    fn cells_lie_where_they_are_on_the_earth() {
        let new_york =
            WGS84.ecef(&Geodetic { longitude: (-74.0f64).to_radians(), latitude: 40.7f64.to_radians(), height_m: 0.0 });
        for token in ["9", "8c", "89", "89c", "89c3", "89c24", "89c25"] {
            let volume = S2Cell::from_token(token).unwrap().oriented_box(&WGS84, -100.0, 500.0);
            assert!(volume.distance_to(new_york) < 1.0, "{token}: {}", volume.distance_to(new_york));
        }
        let away = S2Cell::from_token("1").unwrap().oriented_box(&WGS84, -100.0, 500.0);
        assert!(away.distance_to(new_york) > 10_000.0);
    }

    #[test]
    fn parts_lie_in_their_cells() {
        for token in ["1", "3", "5", "89c24", "b"] {
            let root = S2Cell::from_token(token).unwrap();
            let outer = root.oriented_box(&WGS84, 0.0, 1000.0);
            for (x, y) in (0..4).flat_map(|x| (0..4).map(move |y| (x, y))) {
                let part = root.part(2, x, y);
                assert_eq!((part.level, part.i >> 2, part.j >> 2), (root.level + 2, root.i, root.j));
                let center = part.oriented_box(&WGS84, 0.0, 1000.0).center;
                assert!(outer.distance_to(center) < 1.0, "{token} {x} {y}");
            }
        }
        let deep = S2Cell::from_token("89c24").unwrap().part(40, u32::MAX, 0);
        assert_eq!(deep.level, MAX_LEVEL);
    }
}
