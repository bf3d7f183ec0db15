//! [`GroundTiles`]: what culls know of the tiles of a globe's surface beside their volumes.
//!
//! Such a tile is replaced by its children as soon as those in sight are ready. So only what a camera sees is loaded. The frames
//! in which tiles were replaced are kept: a child that comes into sight without its content does not bring back the coarse tile for
//! its siblings, but is drawn as a part of it.

use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DVec3, Vec3};

use crate::math::{Ellipsoid, WGS84};

/// Tables by tile.
#[derive(Debug)]
pub(crate) struct GroundTiles {
    /// The ellipsoid of the tiles.
    ellipsoid: Ellipsoid,
    /// The height above the ellipsoid, in metres, below which all the tiles are.
    ceiling_m: f64,
    /// Points in ECEF metres, each behind the horizon only if its tile is; infinite for a tile without one.
    horizon_points: Vec<Vec3>,
    /// The frame in which a camera last saw the children of each tile; 0 for never. Culls store it through a shared reference
    /// (relaxed, since it guards no other data).
    refined_in: Vec<AtomicU32>,
}

/// A tile of the ground, in the order in which tiles are added to a page.
#[derive(Debug)]
pub(super) struct GroundTile {
    pub tile: u32,
    pub ellipsoid: Ellipsoid,
    pub ceiling_m: f64,
    pub horizon_point: Option<DVec3>,
}

impl GroundTiles {
    /// The bytes of a tile in the tables.
    pub const BYTES_PER_TILE: usize = size_of::<Vec3>() + size_of::<AtomicU32>();

    /// Creates the tables of a page. `new_index` is the final index of each tile.
    pub(super) fn new(ground: &[GroundTile], new_index: &[u32]) -> Self {
        let mut horizon_points = vec![Vec3::INFINITY; new_index.len()];
        for of_tile in ground {
            if let Some(point) = of_tile.horizon_point {
                horizon_points[new_index[of_tile.tile as usize] as usize] = point.as_vec3();
            }
        }
        let refined_in = new_index.iter().map(|_| AtomicU32::new(0)).collect();
        // If there are other tiles beside the ground, their heights are not known.
        let is_all = ground.len() == new_index.len();
        let ceiling_m = ground.iter().map(|tile| tile.ceiling_m).fold(f64::NEG_INFINITY, f64::max);
        let ceiling_m = if is_all { ceiling_m } else { f64::INFINITY };
        // All tiles of a tree have the same.
        let ellipsoid = ground.first().map_or(WGS84, |tile| tile.ellipsoid);
        Self { ellipsoid, ceiling_m, horizon_points, refined_in }
    }

    /// Returns the ellipsoid of the tiles.
    pub fn ellipsoid(&self) -> &Ellipsoid {
        &self.ellipsoid
    }

    /// Returns the height above the ellipsoid, in metres, below which all the tiles are.
    pub fn ceiling_m(&self) -> f64 {
        self.ceiling_m
    }

    /// Returns the offset of a tile's horizon point from an eye, both in ECEF metres; `None` for a tile without one.
    #[inline]
    pub fn offset_to_horizon_point(&self, tile: u32, eye: DVec3) -> Option<Vec3> {
        let point = self.horizon_points[tile as usize];
        (point.x < f32::INFINITY).then(|| (point.as_dvec3() - eye).as_vec3())
    }

    /// Notes that a camera sees the children of a tile in a frame.
    #[inline]
    pub fn note_refined(&self, tile: u32, frame: u32) {
        self.refined_in[tile as usize].store(frame, Ordering::Relaxed);
    }

    /// Returns true if a camera saw the children of a tile in this frame or in the one before.
    pub fn was_refined(&self, tile: u32, frame: u32) -> bool {
        let last = self.refined_in[tile as usize].load(Ordering::Relaxed);
        last != 0 && last.saturating_add(1) >= frame
    }
}
