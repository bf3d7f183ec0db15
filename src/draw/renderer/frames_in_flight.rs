//! Bounds how many frames the processor is ahead of the adapter. Draw thread.

use std::collections::VecDeque;
use std::time::Duration;

use crate::gpu::{GpuError, GraphicsContext};

/// The number of frames in flight for each target of the device.
const MAX_FRAMES: usize = 2;
/// A frame that takes longer than this counts as a lost device.
const TIMEOUT: Duration = Duration::from_secs(60);

/// The submissions of the latest frames, the oldest first.
#[derive(Default)]
pub(super) struct FramesInFlight(VecDeque<wgpu::SubmissionIndex>);

impl FramesInFlight {
    pub(super) fn push(&mut self, submission: wgpu::SubmissionIndex) {
        self.0.push_back(submission);
    }

    /// Lets wgpu's callbacks run, and waits while too many frames are in flight. Returns an error if the device was lost.
    pub(super) fn throttle(&mut self, ctx: &GraphicsContext) -> Result<(), GpuError> {
        let mut poll = wgpu::PollType::Poll;
        while self.0.len() > MAX_FRAMES * ctx.target_count() {
            poll = wgpu::PollType::Wait { submission_index: self.0.pop_front(), timeout: Some(TIMEOUT) };
        }
        ctx.device().poll(poll).map_err(|e| GpuError::DeviceLost { reason: format!("a frame did not end: {e}") })?;
        ctx.check_lost()
    }
}
