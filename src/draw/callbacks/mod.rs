//! What an application may do while a camera is drawn. Called on the draw thread; must not keep what it is given.

pub(super) mod bins;
pub(super) mod drawables;

use std::sync::Arc;

use super::FrameClock;
use crate::cull::RenderStage;
use crate::scene::{DataVariance, OpaqueDrawData};
use bins::BinDrawing;

/// What a callback is given, and may use.
pub struct RenderInfo<'a> {
    /// To make resources with.
    pub device: &'a wgpu::Device,
    /// To write to them; submit nothing.
    pub queue: &'a wgpu::Queue,
    /// What is drawn, with the camera it was culled for.
    pub stage: &'a RenderStage,
    /// Times of the frame, whose number the camera has.
    pub clock: FrameClock,
}

type OnEncoder = Box<dyn Fn(&RenderInfo<'_>, &mut wgpu::CommandEncoder) + Send + Sync>;
type OnPass = Box<dyn Fn(&RenderInfo<'_>, &mut wgpu::RenderPass<'_>) + Send + Sync>;

/// Callbacks of a camera, in the order they are called; OSG's initial, pre, post and final draw callbacks.
#[derive(Default)]
pub struct CameraCallbacks {
    /// Before everything, the stages drawn before this one included. May record copies and passes of its own.
    pub initial: Option<OnEncoder>,
    /// In the pass, after the clear, before the first bin. May draw and change the pass's state.
    pub pre_draw: Option<OnPass>,
    /// In the pass, after the last bin.
    pub post_draw: Option<OnPass>,
    /// After everything, the stages drawn after this one included.
    pub final_draw: Option<OnEncoder>,
    /// [`DataVariance::Dynamic`] where update changes what they read.
    pub data_variance: DataVariance,
}

impl CameraCallbacks {
    /// To be put into a [`CameraNode`](crate::scene::CameraNode).
    pub fn hook(self) -> OpaqueDrawData {
        OpaqueDrawData(Arc::new(self))
    }

    /// Of what is hooked into a camera.
    pub(crate) fn variance_of(hook: &Option<OpaqueDrawData>) -> DataVariance {
        Self::of(hook).map_or(DataVariance::Static, |callbacks| callbacks.data_variance)
    }

    pub(super) fn of(hook: &Option<OpaqueDrawData>) -> Option<&Self> {
        hook.as_ref()?.0.downcast_ref()
    }
}

type OnBin = Box<dyn Fn(&RenderInfo<'_>, &mut BinDrawing<'_, '_, '_>) + Send + Sync>;

/// Draws a render bin in place of the renderer, or around it; OSG's `RenderBin::DrawCallback`. To be put into the
/// state set that names the bin ([`StateSet::bin_callback`](crate::state::StateSet::bin_callback)).
///
/// It is called once for each stage in which the bin has leaves, at the bin's place in the pass; where the bin holds
/// leaves that write no depth, that is after the sky. Bins nested in it are its to draw too.
pub struct BinCallback {
    /// Draws the bin.
    pub draw: OnBin,
    /// [`DataVariance::Dynamic`] where update changes what it reads.
    pub data_variance: DataVariance,
}

impl BinCallback {
    /// A callback that reads nothing that update changes in place.
    pub fn new(draw: impl Fn(&RenderInfo<'_>, &mut BinDrawing<'_, '_, '_>) + Send + Sync + 'static) -> Self {
        Self { draw: Box::new(draw), data_variance: DataVariance::Static }
    }

    /// To be put into a [`StateSet`](crate::state::StateSet).
    pub fn hook(self) -> OpaqueDrawData {
        OpaqueDrawData(Arc::new(self))
    }

    /// Of what is hooked to the bins of a stage.
    pub(crate) fn are_dynamic(stage: &RenderStage) -> bool {
        let mut hooks = stage.bins.iter().flat_map(|bin| bin.callbacks.iter().flatten());
        hooks.any(|hook| Self::of(hook).is_some_and(|c| c.data_variance == DataVariance::Dynamic))
    }

    pub(super) fn of(hook: &OpaqueDrawData) -> Option<&Self> {
        hook.0.downcast_ref()
    }
}
