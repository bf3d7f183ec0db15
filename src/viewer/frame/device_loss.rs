//! [`DeviceLoss`]: a lost device is reported by the next frame, which replaces it; a device that is lost again at once is
//! not replaced, and neither is the application's own ([`HostDevice`](crate::gpu::HostDevice)). Main thread.

use crate::gpu::GpuError;

/// A device that is lost within this many frames after the last replacement is not replaced.
const MIN_FRAMES_BETWEEN: u32 = 60;

/// The loss that no frame has reported, and the last replacement.
#[derive(Debug, Default)]
pub(in crate::viewer) struct DeviceLoss {
    /// The loss of a frame in flight.
    pending: Option<GpuError>,
    /// The frame in which a device was last replaced; 0 when none was.
    replaced_frame: u32,
}

impl DeviceLoss {
    /// Notes that a frame in flight was lost with its device.
    pub(super) fn note(&mut self, error: GpuError) {
        self.pending.get_or_insert(error);
    }

    pub(super) fn pending(&self) -> Option<&GpuError> {
        self.pending.as_ref()
    }

    /// Returns the pending loss as an error, once.
    pub(super) fn report(&mut self) -> Result<(), GpuError> {
        self.pending.take().map_or(Ok(()), Err)
    }

    pub(super) fn may_replace(&self, frame: u32) -> bool {
        self.replaced_frame == 0 || frame - self.replaced_frame >= MIN_FRAMES_BETWEEN
    }

    /// Notes that devices are being replaced in a frame.
    pub(super) fn note_replacement(&mut self, frame: u32) {
        self.replaced_frame = frame;
    }

    /// Forgets the pending loss: the lost devices were replaced or closed.
    pub(super) fn clear(&mut self) {
        self.pending = None;
    }
}
