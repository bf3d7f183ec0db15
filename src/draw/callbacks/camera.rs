//! Callbacks of cameras: OSG's initial, pre, post and final draw callbacks. Draw thread.

use std::sync::Arc;

use super::info::RenderInfo;
use crate::state::{DataVariance, OpaqueDrawData};

type OnEncoder = Box<dyn Fn(&RenderInfo<'_>, &mut wgpu::CommandEncoder) + Send + Sync>;
type OnPass = Box<dyn Fn(&RenderInfo<'_>, &mut wgpu::RenderPass<'_>) + Send + Sync>;

/// The callbacks of a camera, in the order in which they are called; OSG's initial, pre, post and final draw callbacks.
#[derive(Default)]
pub struct CameraCallbacks {
    /// Called before the stage: after the stages drawn before that of a view's own camera, and before the stages drawn before
    /// that of a camera in the graph, as OSG does. It may record copies and passes.
    pub initial: Option<OnEncoder>,
    /// Called in the render pass, after the clear, with which a pass of wgpu begins, and before the first bin. It may draw and
    /// change the pass's state.
    pub pre_draw: Option<OnPass>,
    /// Called in the render pass after the last bin.
    pub post_draw: Option<OnPass>,
    /// Called after the stage and all stages drawn after it.
    pub final_draw: Option<OnEncoder>,
    /// [`DataVariance::Dynamic`] if the update phase changes data that the callbacks read.
    pub data_variance: DataVariance,
}

impl CameraCallbacks {
    /// Packs the callbacks for a [`CameraNode`](crate::scene::CameraNode).
    pub fn hook(self) -> OpaqueDrawData {
        OpaqueDrawData(Arc::new(self))
    }

    /// Returns the variance of the callbacks that a camera holds.
    pub(crate) fn variance_of(hook: &Option<OpaqueDrawData>) -> DataVariance {
        Self::of(hook).map_or(DataVariance::Static, |callbacks| callbacks.data_variance)
    }

    pub(in crate::draw) fn of(hook: &Option<OpaqueDrawData>) -> Option<&Self> {
        hook.as_ref()?.0.downcast_ref()
    }
}
