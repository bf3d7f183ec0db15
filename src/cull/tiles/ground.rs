//! The surface of a globe: a tile is replaced by its children as soon as those in sight are ready. Culling thread.
//!
//! Children out of sight are neither requested nor waited for. When one comes into sight, its siblings stay, and the part of an
//! ancestor that it covers is drawn in its place until it is loaded. Until a tile has been replaced once, it waits for all of its
//! children in sight. The walk (`test_tile`) leaves out the requests.

use glam::DVec3;

use super::walk_context::WalkContext;
use crate::cull::visitor::Traversal;
use crate::scene::{GroundTiles, LodRanges, Readiness, TileRecord, flag};

/// Distances to the ground are at least this share of the eye's height above it. The rest is for the difference between the
/// height along the line to the earth's centre and that along the normal, and for rounding.
const HEIGHT_SHARE: f64 = 0.999;
/// Tiles with a larger radius are tested by the parts of their surface, metres. Those are at least 0.03 radians wide or high, so that
/// the page knows their regions, and `surface_parts.rs` limits the parts that are looked at.
const MIN_LARGE_M: f32 = 95_000.0;
/// Tiles with a larger radius are tested by those below them, metres. These are the tiles of the first four levels; a view has less
/// than 45 of them.
const MIN_DIVIDED_M: f32 = 800_000.0;

/// Returns ranges that count no tile of a globe's surface as nearer than the ground below the eye. The box around a large tile
/// reaches far above the surface. `eye` is in ECEF metres.
pub(super) fn ranges_above(ground: &GroundTiles, ranges: LodRanges, eye: DVec3) -> LodRanges {
    let height_m = eye.length() * (1.0 - (eye / ground.ellipsoid().radii_m()).length().recip());
    ranges.not_nearer_than(HEIGHT_SHARE * (height_m - ground.ceiling_m()))
}

impl Traversal<'_> {
    /// Returns true if children can be drawn instead of their tile without a hole. `mask` are the planes that the tile crosses.
    #[inline(always)]
    pub(super) fn can_be_replaced(&mut self, walk: &WalkContext, tile: u32, record: &TileRecord, mask: u8) -> bool {
        record.not_ready_children == 0
            || walk.tiles.ground().is_some_and(|ground| self.is_ready_in_sight(walk, ground, tile, mask))
    }

    /// Returns true if the children of a tile of the ground that are in sight can be drawn instead of it. A view for shadows sees
    /// other tiles: it follows what cameras saw last.
    #[cold]
    #[inline(never)]
    fn is_ready_in_sight(&mut self, walk: &WalkContext, ground: &GroundTiles, tile: u32, mask: u8) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let was_refined = ground.was_refined(tile, self.camera.frame);
        if !walk.requests {
            return was_refined;
        }
        let (mut shows_one, mut lacks_one) = (false, false);
        for child in record.first_child..record.end_of_children() {
            if self.is_out_of_sight(walk, child, mask) {
                continue;
            }
            match self.readiness_in_sight(walk, ground, child, mask) {
                Readiness::Ready => shows_one = true,
                Readiness::Unavailable => lacks_one = true,
                Readiness::Missing if was_refined => lacks_one = true,
                Readiness::Missing => return false,
            }
        }
        shows_one && (!lacks_one || self.has_resident_from(walk, tile))
    }

    fn readiness_in_sight(&mut self, walk: &WalkContext, ground: &GroundTiles, tile: u32, mask: u8) -> Readiness {
        let record = &walk.tiles.records()[tile as usize];
        let readiness = self.scene.readiness(walk.page_id.slot, tile as usize);
        // The children of a tile without its content can stand in for it.
        let may_stand_in = readiness != Readiness::Ready && record.has_children() && !record.has(flag::EXTERNAL);
        if may_stand_in && self.is_ready_in_sight(walk, ground, tile, mask) { Readiness::Ready } else { readiness }
    }

    /// Returns true if a tile is outside of the frustum, or behind the horizon or an occluder, or if its parts are.
    fn is_out_of_sight(&mut self, walk: &WalkContext, tile: u32, mask: u8) -> bool {
        let bounds = &walk.tiles.bounds()[tile as usize];
        let crossing = if mask == 0 { Some(0) } else { walk.test(bounds, mask) };
        let Some(crossing) = crossing else { return true };
        (walk.may_be_behind && self.is_behind(walk, tile)) || self.has_no_part_in_sight(walk, tile, crossing)
    }

    /// Returns true if a large tile of the ground is out of sight although its box is not: by its surface, or because all the tiles
    /// below it are. The box of a quarter of the earth reaches far beyond the surface. `mask` are the planes that the tile crosses.
    #[inline]
    pub(super) fn has_no_part_in_sight(&mut self, walk: &WalkContext, tile: u32, mask: u8) -> bool {
        let radius_m = walk.tiles.bounds()[tile as usize].radius_m();
        if radius_m <= MIN_LARGE_M || walk.is_top_of_ground(tile) {
            return false;
        }
        let Some(ground) = walk.tiles.ground() else { return false };
        let record = &walk.tiles.records()[tile as usize];
        walk.surface_is_out_of_sight(ground, tile, mask)
            || radius_m > MIN_DIVIDED_M
                && record.has_children()
                && (record.first_child..record.end_of_children()).all(|child| self.is_out_of_sight(walk, child, mask))
    }

    /// Returns true if the content of a tile or of one above it is resident: it can be drawn in place of what is missing.
    fn has_resident_from(&self, walk: &WalkContext, tile: u32) -> bool {
        let (mut tiles, mut tile, mut page_at) = (walk.tiles, tile, walk.page_id.slot);
        while tiles.resident_from(tile).is_none() {
            let Some((holder, above)) = self.scene.tile_above(page_at) else { return false };
            let Some(page) = self.scene.page_at(holder) else { return false };
            (tiles, tile, page_at) = (page.tiles(), above as u32, holder);
        }
        true
    }
}
