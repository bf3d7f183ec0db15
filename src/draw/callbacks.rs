//! What an application may do while a camera is drawn. Called on the draw thread; must not keep what it is given.

use std::sync::Arc;

use crate::cull::RenderStage;
use crate::scene::{DataVariance, DrawHook};

/// What a callback is given, and may use.
pub struct RenderInfo<'a> {
    /// To make resources with.
    pub device: &'a wgpu::Device,
    /// To write to them; submit nothing.
    pub queue: &'a wgpu::Queue,
    /// What is drawn.
    pub stage: &'a RenderStage,
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
    pub fn hook(self) -> DrawHook {
        DrawHook(Arc::new(self))
    }

    /// Of what is hooked into a camera.
    pub(crate) fn variance_of(hook: &Option<DrawHook>) -> DataVariance {
        Self::of(hook).map_or(DataVariance::Static, |callbacks| callbacks.data_variance)
    }

    pub(super) fn of(hook: &Option<DrawHook>) -> Option<&Self> {
        hook.as_ref()?.0.downcast_ref()
    }
}
