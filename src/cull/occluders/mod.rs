//! Occlusion by OccluderNodes: bounds that lie wholly in the shadow volume of one are culled. Culling thread.
//!
//! The occluders of a view are collected before its scene is culled. Their planes are then moved into the frame of each
//! page and of each tile tree, where bounds are stored.

mod collect;
mod volumes;

use glam::{DAffine3, DVec3, Vec4};

use self::collect::Chain;
pub(super) use self::collect::Collector;
use self::volumes::{FrameOccluders, Occluders};

/// The occluders of a stage, and their planes in the frames of the current page and tile tree.
///
/// They hold for the stage's own view only: other views of the stage have another eye or other rays.
#[derive(Debug, Default)]
pub(super) struct Occlusion {
    occluders: Occluders,
    /// Bounds of the current view are tested: it is the stage's own, and there are occluders.
    is_active: bool,
    page: FrameOccluders,
    tiles: FrameOccluders,
    /// Scratch memory of the collector.
    chain: Chain,
}

impl Occlusion {
    /// Starts a stage: collects the occluders that its view shows, or none without a collector.
    pub fn start_stage(&mut self, collector: Option<&Collector>) {
        let max_count = collector.map_or(0, |collector| collector.view.camera.settings.max_occluders as usize);
        self.occluders.clear(max_count);
        if let Some(collector) = collector.filter(|_| max_count > 0) {
            collector.collect(&mut self.occluders, &mut self.chain);
        }
        self.is_active = !self.occluders.is_empty();
    }

    /// Changes the view that bounds belong to; 0 is the stage's own.
    pub fn enter_view(&mut self, view: u32) {
        self.is_active = view == 0 && !self.occluders.is_empty();
    }

    /// Returns true if no view of the stage has occluders.
    pub fn is_empty(&self) -> bool {
        self.occluders.is_empty()
    }

    /// Returns true if bounds of the current view may be occluded.
    #[inline(always)]
    pub fn is_active(&self) -> bool {
        self.is_active
    }

    /// Moves the occluders into the frame of a page, relative to its origin.
    pub fn enter_page(&mut self, eye_from_page: &DAffine3, origin: DVec3) {
        if self.is_active {
            self.occluders.in_frame(eye_from_page, origin, &mut self.page);
        }
    }

    /// Moves the occluders into the frame of tile trees, relative to the eye.
    pub fn enter_tiles(&mut self, eye_from_tiles: &DAffine3, eye: DVec3) {
        if self.is_active {
            self.occluders.in_frame(eye_from_tiles, eye, &mut self.tiles);
        }
    }

    /// Returns true if a bound of the current page is occluded. `reach` is its extent along a direction.
    #[inline]
    pub fn hides_in_page(&self, center: [f32; 3], reach: impl Fn(Vec4) -> f32) -> bool {
        self.is_active && self.occluders.hide(&self.page, center, reach)
    }

    /// Returns true if a bound of the current tile trees is occluded. `offset` is its centre relative to the eye.
    #[inline]
    pub fn hides_in_tiles(&self, offset: [f32; 3], reach: impl Fn(Vec4) -> f32) -> bool {
        self.is_active && self.occluders.hide(&self.tiles, offset, reach)
    }
}
