//! [`GroundTiles`]: what culls know of the tiles of a globe's surface beside their volumes.
//!
//! Such a tile is replaced by its children as soon as those in sight are ready. So only what a camera sees is loaded. The frames
//! in which tiles were replaced are kept: a child that comes into sight without its content does not bring back the coarse tile for
//! its siblings, but is drawn as a part of it.

use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DVec3, Vec3};

use crate::math::{Ellipsoid, Region, WGS84, horizon_point};

/// The box of a smaller tile fits its surface well, radians along its longer side.
const MIN_LARGE: f64 = 0.03;

/// Tables by tile.
#[derive(Debug)]
pub(crate) struct GroundTiles {
    /// The ellipsoid of the tiles.
    ellipsoid: Ellipsoid,
    /// The height above the ellipsoid, in metres, below which all the tiles are.
    ceiling_m: f64,
    /// Points in ECEF metres, each behind the horizon only if its tile is; infinite for a tile without one.
    horizon_points: Vec<Vec3>,
    /// The regions of large tiles, in the order of their indices.
    large: Vec<(u32, Region)>,
    /// The frame in which a camera last saw the children of each tile; 0 for never. Culls store it through a shared reference
    /// (relaxed, since it guards no other data).
    refined_in: Vec<AtomicU32>,
}

/// A tile of the ground, in the order in which tiles are added to a page.
#[derive(Debug)]
pub(super) struct GroundTile {
    pub tile: u32,
    pub region: Region,
}

impl GroundTiles {
    /// Creates the tables of a page. `new_index` is the final index of each tile.
    pub(super) fn new(ground: &[GroundTile], new_index: &[u32]) -> Self {
        let mut horizon_points = vec![Vec3::INFINITY; new_index.len()];
        for of_tile in ground {
            if let Some(point) = horizon_point(&of_tile.region) {
                horizon_points[new_index[of_tile.tile as usize] as usize] = point.as_vec3();
            }
        }
        let is_large = |region: &Region| region.width().max(region.north - region.south) >= MIN_LARGE;
        let large = ground.iter().filter(|of| is_large(&of.region));
        let mut large: Vec<_> = large.map(|of| (new_index[of.tile as usize], of.region)).collect();
        large.sort_unstable_by_key(|(tile, _)| *tile);
        let refined_in = new_index.iter().map(|_| AtomicU32::new(0)).collect();
        // If there are other tiles beside the ground, their heights are not known.
        let is_all = ground.len() == new_index.len();
        let ceiling_m = ground.iter().map(|tile| tile.region.max_height_m).fold(f64::NEG_INFINITY, f64::max);
        let ceiling_m = if is_all { ceiling_m } else { f64::INFINITY };
        // All tiles of a tree have the same.
        let ellipsoid = ground.first().map_or(WGS84, |tile| tile.region.ellipsoid);
        Self { ellipsoid, ceiling_m, horizon_points, large, refined_in }
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

    /// Returns the region of a large tile; `None` for a small one.
    pub fn large_region(&self, tile: u32) -> Option<&Region> {
        let at = self.large.binary_search_by_key(&tile, |(of, _)| *of).ok()?;
        Some(&self.large.get(at)?.1)
    }

    /// Returns the bytes of the tables.
    pub fn size_bytes(&self) -> usize {
        let per_tile = size_of::<Vec3>() + size_of::<AtomicU32>();
        self.refined_in.len() * per_tile + self.large.len() * size_of::<(u32, Region)>()
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
