//! Values that stay constant during the walk of one tile tree, and the tests of a tile that need nothing more. Culling
//! thread.

use std::sync::atomic::{AtomicU32, Ordering};

use super::surface;
use super::tile_view::TileView;
use crate::cull::fading::{FadeStep, FadeTarget, TileMark};
use crate::scene::{ContentShape, GroundTiles, LodRanges, Page, PageId, TileBounds, TileRecord, TileRoot, Tiles, flag};

/// Flags of the usual tile: content that its children replace.
pub(super) const REPLACE_WITH_CONTENT: u16 = flag::CONTENT;
/// Flags that tell the kinds of tiles apart.
pub(super) const CONTENT_KINDS: u16 = flag::CONTENT | flag::PROXY | flag::EXTERNAL | flag::ADD;
/// Flags that must equal [`REPLACE_WITH_CONTENT`] for the fast loops; all other tiles are visited one by one.
pub(super) const SLOW_PATH: u16 = CONTENT_KINDS | flag::OWN_PATH | flag::VOLUMES_BELOW | flag::CONTENT_VOLUME;

/// A tile tree under walk.
pub(super) struct WalkContext<'a> {
    pub page: &'a Page,
    pub page_id: PageId,
    pub tiles: &'a Tiles,
    pub root: &'a TileRoot,
    pub view: TileView,
    /// The planes that the tree may cross.
    pub mask: u8,
    pub ranges: LodRanges,
    pub max_sse_px2: f32,
    /// Levels are skipped while the squared error of what is drawn, scaled by the tile's range and distance, is below this.
    /// 0 skips no level.
    pub skip_px2: f32,
    /// Missing tiles are requested; false for shadows, which use what is resident.
    pub requests: bool,
    pub cull_mask: u32,
    /// Some tile may be hidden by its mask, or by the volume in which it may be requested.
    pub may_hide: bool,
    /// Some tile may be behind the horizon or an occluder.
    pub may_be_behind: bool,
    /// The progress of fades in this cull.
    pub step: FadeStep,
    pub stamp: UseStamp,
}

/// The frame number that wanted tiles are stamped with, so that the pager keeps them.
#[derive(Clone, Copy)]
pub(super) struct UseStamp {
    /// The frame of the cull; 0 stamps nothing.
    pub frame: u32,
    /// The frame for which the tiles are wanted; later than `frame` for a prefetch.
    pub wanted_in: u32,
}

impl UseStamp {
    /// Returns true for a cull that stamps, of a frame that is shown now.
    pub fn shows(self) -> bool {
        self.frame != 0 && self.frame == self.wanted_in
    }

    /// Stamps a tile. A prefetch (`AHEAD`) leaves a tile that is in use or wanted sooner.
    #[inline(always)]
    pub fn put<const AHEAD: bool>(self, last_used: &AtomicU32) {
        if self.frame != 0 && (!AHEAD || !(self.frame - 1..self.wanted_in).contains(&last_used.load(Ordering::Relaxed)))
        {
            last_used.store(self.wanted_in, Ordering::Relaxed);
        }
    }
}

/// Returns true if a tile shows its children, which `is_near` says it wants. Where its own content is not resident, ready
/// children stand in for it even if it does not want them.
pub(in crate::cull) fn shows_children(record: &TileRecord, is_near: bool) -> bool {
    let replaces = !record.has(flag::ADD);
    let are_ready = !replaces || record.not_ready_children == 0;
    record.has_children() && are_ready && (is_near || (replaces && !record.has(flag::RESIDENT)))
}

/// Returns true if a tile's fade has finished and its refinement and residency have not changed. Without marks nothing
/// fades.
#[inline(always)]
pub(super) fn is_settled(marks: &mut [TileMark], tile: usize, step: FadeStep, target: FadeTarget) -> bool {
    marks.get_mut(tile).is_none_or(|mark| mark.is_settled(step, target))
}

impl WalkContext<'_> {
    /// Returns true if something besides the frustum culls tiles.
    #[inline(always)]
    pub fn needs_all_tests(&self) -> bool {
        self.may_hide || self.may_be_behind
    }

    /// Returns true if a tile is replaced only by all its children together: culled ones are kept and requested too.
    #[inline(always)]
    pub fn requires_all(&self) -> bool {
        self.tiles.ground().is_none()
    }

    /// Returns true for the top tile of a page with a part of a globe's surface. Its slot in the page above has the same
    /// volume, as far as it was known there, and was tested.
    #[inline]
    pub fn is_top_of_ground(&self, tile: u32) -> bool {
        self.tiles.ground().is_some() && self.tiles.records()[tile as usize].depth == 0
    }

    /// Notes for the surface of a globe that a camera sees the children of a tile.
    #[inline(always)]
    pub fn note_refined(&self, tile: u32) {
        if let (Some(ground), true) = (self.tiles.ground(), self.stamp.shows()) {
            ground.note_refined(tile, self.stamp.frame);
        }
    }

    /// Returns true if a missing tile is drawn as a part of the content above it.
    #[inline(always)]
    pub fn stands_in(&self, record: &TileRecord) -> bool {
        record.has(flag::UNAVAILABLE) || self.tiles.ground().is_some()
    }

    /// Returns the path of the state sets above a tile's content.
    #[inline]
    pub fn state_path(&self, tile: u32, record: &TileRecord) -> u32 {
        if record.has(flag::OWN_PATH) { self.tiles.state_path(tile, self.root) } else { self.root.state_path }
    }

    /// Returns true if a tile's content may be replaced by its children; also for tiles without such content.
    #[inline(always)]
    pub fn may_be_replaced(&self, record: &TileRecord) -> bool {
        self.tiles.may_be_replaced(record, self.view.eye.position)
    }

    /// Returns true if the cull mask hides a tile.
    #[inline]
    pub fn is_hidden(&self, tile: u32) -> bool {
        let node = self.tiles.nodes()[tile as usize] as usize;
        self.page.masks().get(node).copied().unwrap_or(u32::MAX) & self.cull_mask == 0
    }

    /// Tests a tile against the planes in `mask`. Returns the planes that it crosses, or `None` if it is outside.
    #[inline(always)]
    pub fn test(&self, bounds: &TileBounds, mask: u8) -> Option<u8> {
        if bounds.is_along_frame() {
            return self.view.grid_planes.test_aligned(self.view.eye.steps_to(bounds), bounds.extent(), mask);
        }
        let offset = self.view.eye.offset_to(bounds);
        if bounds.is_sphere() {
            self.view.planes.test_sphere(offset.with_w(bounds.radius_m()), mask)
        } else {
            self.view.planes.test_oriented(offset, self.tiles.axes_of(bounds), bounds.half_m(), mask)
        }
    }

    /// Returns true if no part of a large tile of the ground is in sight. Its box may be.
    #[inline]
    pub fn surface_is_out_of_sight(&self, ground: &GroundTiles, tile: u32, mask: u8) -> bool {
        let view = &self.view;
        let Some(horizon) = view.horizon.as_ref().filter(|horizon| horizon.is_in_ecef()) else { return false };
        // If the middle of its box is in sight, a part of the tile is.
        let middle = view.eye.offset_to(&self.tiles.bounds()[tile as usize]).truncate();
        let is_middle_seen =
            !view.planes.spheres_are_outside(&[middle], 0.0, mask) && !horizon.hides(middle.to_array(), 0.0);
        let is_out = |region: &_| surface::is_out_of_sight(region, view.eye.position, (&view.planes, mask), horizon);
        !is_middle_seen && ground.large_region(tile).is_some_and(is_out)
    }

    /// Returns true if the volume of a tile's content is smaller than the tile's, and outside of the frustum. The tile may be inside.
    #[inline(always)]
    pub fn content_is_outside(&self, tile: u32, record: &TileRecord) -> bool {
        record.has(flag::CONTENT_VOLUME) && self.content_volume_is_outside(tile)
    }

    #[cold]
    fn content_volume_is_outside(&self, tile: u32) -> bool {
        let Some(volume) = self.tiles.content_volume(tile) else { return false };
        let (offset, shape) = volume.seen_from(self.view.eye.position);
        let crossing = match shape {
            ContentShape::Sphere { radius_m } => self.view.planes.test_sphere(offset.with_w(*radius_m), self.mask),
            ContentShape::Box { axes, half_m } => self.view.planes.test_oriented(offset, axes, *half_m, self.mask),
        };
        crossing.is_none()
    }

    /// Returns the squared error of a tile in pixels; the root is taken only where a request needs it.
    #[inline(always)]
    pub fn px2(&self, (range2, distance2): (f32, f32)) -> f32 {
        self.max_sse_px2 * (range2 / distance2)
    }

    /// Returns true if a missing tile is skipped: its children will replace it, and it is not much finer than what is drawn
    /// until then.
    #[inline(always)]
    pub fn skips(&self, record: &TileRecord, (range2, distance2): (f32, f32), shown_px2: f32) -> bool {
        // The tile above cannot tell whether what is below the top tile of another page is in sight.
        let is_top_of_ground = record.depth == 0 && self.tiles.ground().is_some();
        shown_px2 * distance2 < self.skip_px2 * range2
            && !is_top_of_ground
            && record.flags & (flag::CONTENT_BELOW | flag::FAILED_BELOW) == flag::CONTENT_BELOW
    }

    /// Returns the squared error of what is drawn while the children of a tile are missing. It is always less than above,
    /// so that coarse tiles are requested first whatever the bounds are.
    #[inline(always)]
    pub fn below_px2(&self, range2: f32, distance2: f32, above_px2: f32) -> f32 {
        let (own, limit) = (self.px2((range2, distance2)), above_px2 * 0.998);
        if own < limit { own } else { limit }
    }

    /// Returns the squared distance at which a tile wants its children, and its squared distance.
    #[inline(always)]
    pub fn range_and_distance(&self, tile: u32, record: &TileRecord, bounds: &TileBounds) -> (f32, f32) {
        self.tiles.range_and_distance(tile, record, bounds, &self.view.eye, &self.ranges)
    }
}
