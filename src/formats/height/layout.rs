//! The placement of a height tile on the earth or on a plane, and the coordinates of its rows and columns.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DAffine3, DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::math::Ellipsoid;

/// The area that a tile covers. Its samples divide it evenly.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) enum Placement {
    /// West, south, east and north on the ellipsoid of the set, in radians. East is beyond pi for a tile across the antimeridian.
    #[serde(rename = "region")]
    Region([f64; 4]),
    /// Smallest x and y, largest x and y on a plane with z up, in metres of the tile's frame.
    #[serde(rename = "plane")]
    Plane([f64; 4]),
}

/// The coordinates of a tile as small differences from its origin. [`HeightTile`](crate::scene::HeightTile) documents the
/// meaning of rows and columns.
pub(super) struct Layout {
    pub rows: Vec<[f32; 4]>,
    pub columns: Vec<[f32; 2]>,
    /// Distance of the origin from the earth's axis in metres.
    pub p0_m: f64,
    /// Size of a cell in metres along columns and rows.
    pub cell_m: [f32; 2],
    pub world_from_tile: DAffine3,
}

impl Placement {
    /// Returns true if the area is finite and not empty.
    pub fn is_valid(self) -> bool {
        // Longitudes may exceed pi for tiles across the antimeridian.
        let ([w, s, e, n], [max_x, max_y]) = match self {
            Self::Region(region) => (region, [2.0 * TAU, FRAC_PI_2 + 1e-6]),
            Self::Plane(plane) => (plane, [1e9, 1e9]),
        };
        w.abs().max(e.abs()) < max_x && s.abs().max(n.abs()) < max_y && w < e && s < n
    }

    /// Returns the coordinates of `side` rows and columns on an ellipsoid, or on a plane.
    pub fn layout(self, ellipsoid: &Ellipsoid, side: usize) -> Layout {
        match self {
            Self::Region(region) => on_ellipsoid(ellipsoid, region, side),
            Self::Plane(plane) => on_plane(plane, side),
        }
    }
}

fn on_ellipsoid(ellipsoid: &Ellipsoid, [west, south, east, north]: [f64; 4], side: usize) -> Layout {
    let cells = (side - 1) as f64;
    let (lon_0, lat_0) = (0.5 * (west + east), 0.5 * (south + north));
    let e2 = ellipsoid.eccentricity_squared();
    let n_0 = ellipsoid.prime_vertical_radius_m(lat_0);
    let (p_0, z_0) = (n_0 * lat_0.cos(), n_0 * (1.0 - e2) * lat_0.sin());
    let row = |j: usize| {
        let lat = south + (north - south) * j as f64 / cells;
        let n = ellipsoid.prime_vertical_radius_m(lat.clamp(-FRAC_PI_2, FRAC_PI_2));
        let (sin, cos) = lat.sin_cos();
        [(n * cos - p_0) as f32, (n * (1.0 - e2) * sin - z_0) as f32, cos as f32, sin as f32]
    };
    let column = |i: usize| {
        let half = 0.5 * ((east - west) * (i as f64 / cells - 0.5));
        [(2.0 * half).sin() as f32, (2.0 * half.sin() * half.sin()) as f32]
    };
    let (sin_lon, cos_lon) = lon_0.sin_cos();
    let axes = DMat3::from_cols(DVec3::new(-sin_lon, cos_lon, 0.0), DVec3::new(cos_lon, sin_lon, 0.0), DVec3::Z);
    Layout {
        rows: (0..side).map(row).collect(),
        columns: (0..side).map(column).collect(),
        p0_m: p_0,
        cell_m: [(p_0 * (east - west) / cells) as f32, ((north - south) / cells * ellipsoid.semi_major_m) as f32],
        world_from_tile: DAffine3 { matrix3: axes, translation: DVec3::new(p_0 * cos_lon, p_0 * sin_lon, z_0) },
    }
}

/// A distance from the axis so large that the curvature of a tile vanishes in `f32`.
const FLAT_M: f64 = 1e15;

/// Represents a plane by the form of the ellipsoid, as the pole of an infinitely large earth: the radial axis points south, the
/// polar axis up.
fn on_plane([x_0, y_0, x_1, y_1]: [f64; 4], side: usize) -> Layout {
    let cells = (side - 1) as f64;
    let from_center = |k: usize| k as f64 / cells - 0.5;
    Layout {
        rows: (0..side).map(|j| [((y_0 - y_1) * from_center(j)) as f32, 0.0, 0.0, 1.0]).collect(),
        columns: (0..side).map(|i| [((x_1 - x_0) * from_center(i) / FLAT_M) as f32, 0.0]).collect(),
        p0_m: FLAT_M,
        cell_m: [((x_1 - x_0) / cells) as f32, ((y_1 - y_0) / cells) as f32],
        world_from_tile: DAffine3 {
            matrix3: DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::Z),
            translation: DVec3::new(0.5 * (x_0 + x_1), 0.5 * (y_0 + y_1), 0.0),
        },
    }
}
