//! Leaves, the drawables of a stage, and the bins that hold them in draw order.

use crate::scene::DrawSlot;
use crate::state::{BinDetails, OpaqueDrawData, SortMode};

/// One drawable of a frame. 16 bytes, since there are many.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderLeaf {
    /// Slot of the drawable in the graphics context; the renderer skips `DrawSlot::NONE`.
    pub slot: DrawSlot,
    /// Index into [`RenderStage::state_sets`](super::RenderStage::state_sets).
    pub state: u32,
    /// Index into [`RenderStage::eye_from_drawable`](super::RenderStage::eye_from_drawable).
    pub matrix: u32,
    /// Depth of the bound's centre in front of the eye, metres.
    pub depth: f32,
}

/// A render bin with its leaves.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderBin {
    /// The bins that it is nested in, and the bin itself; empty for the stage's own leaves.
    pub path: Vec<BinDetails>,
    /// By index into `path`: the callback that draws the bin instead of the renderer. May be shorter than `path`.
    pub callbacks: Vec<Option<OpaqueDrawData>>,
    /// The order of the leaves.
    pub sort: SortMode,
    /// Leaves in draw order.
    pub leaves: Vec<RenderLeaf>,
}

impl RenderBin {
    /// Returns the bin's number inside the bin around it; 0 for the stage's own leaves.
    pub fn number(&self) -> i32 {
        self.path.last().map_or(0, |b| b.number)
    }
}

impl RenderBin {
    /// Adds callbacks for bins of the path that have none yet.
    pub(in crate::cull) fn add_callbacks(&mut self, callbacks: &[Option<OpaqueDrawData>]) {
        for (index, callback) in callbacks.iter().enumerate().filter(|(_, c)| c.is_some()) {
            if self.callbacks.len() <= index {
                self.callbacks.resize(index + 1, None);
            }
            if let Some(own @ None) = self.callbacks.get_mut(index) {
                own.clone_from(callback);
            }
        }
    }
}
