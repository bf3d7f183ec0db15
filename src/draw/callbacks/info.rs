//! The data that callbacks of the draw phase are given.

use crate::cull::RenderStage;

/// The times of a frame, for programs and callbacks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameClock {
    /// Seconds since the first frame.
    pub reference_time_s: f64,
    /// Seconds since the previous frame.
    pub delta_s: f64,
    /// Seconds of the application's own time.
    pub simulation_time_s: f64,
}

/// The device, stage and times that a callback may use.
pub struct RenderInfo<'a> {
    /// The device, for creating resources.
    pub device: &'a wgpu::Device,
    /// The queue, for writing to resources. A callback must not submit to it.
    pub queue: &'a wgpu::Queue,
    /// The stage that is drawn, with the camera it was culled for.
    pub stage: &'a RenderStage,
    /// The times of the frame. The frame's number is in the stage's camera.
    pub clock: FrameClock,
}
