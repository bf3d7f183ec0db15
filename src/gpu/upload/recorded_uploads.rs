//! [`RecordedUploads`]: upload commands on their way to the adapter, and the staging buffers that they copy from. Draw
//! thread.

/// Uploads are submitted at the latest when this much is recorded while frames are drawn. Frames take uploads along with
/// their own submission, and would wait for one in between.
const FLUSH_BYTES_DRAWING: u64 = 4 << 20;
/// Uploads are submitted at the latest when this much is recorded while no frames are drawn.
const FLUSH_BYTES_IDLE: u64 = 256 << 10;

/// Recorded commands and the staging buffers of submitted ones.
#[derive(Default)]
pub(super) struct RecordedUploads {
    /// Recorded and not submitted.
    commands: Vec<wgpu::CommandBuffer>,
    /// Staging buffers that `commands` copy from.
    sources: Vec<wgpu::Buffer>,
    /// Staging buffers whose commands were submitted.
    submitted: Vec<wgpu::Buffer>,
    /// Bytes uploaded since the last submission, recorded or written by the queue.
    unflushed_bytes: u64,
    /// True if a frame was submitted since the last submission of uploads alone.
    is_drawing: bool,
}

impl RecordedUploads {
    pub(super) fn push(&mut self, commands: Option<wgpu::CommandBuffer>, source: Option<wgpu::Buffer>) {
        self.commands.extend(commands);
        self.sources.extend(source);
    }

    pub(super) fn count_bytes(&mut self, bytes: u64) {
        self.unflushed_bytes += bytes;
    }

    /// Returns true while frames are drawn.
    pub(super) fn is_drawing(&self) -> bool {
        self.is_drawing
    }

    pub(super) fn is_empty(&self) -> bool {
        self.commands.is_empty()
    }

    /// Returns the number of staging buffers whose commands were not submitted.
    pub(super) fn unsubmitted_sources(&self) -> usize {
        self.sources.len()
    }

    /// Returns true if uploads should not wait for the next frame's submission.
    pub(super) fn is_flush_due(&self) -> bool {
        self.unflushed_bytes >= if self.is_drawing { FLUSH_BYTES_DRAWING } else { FLUSH_BYTES_IDLE }
    }

    /// Notes that the next frame's submission takes along everything written by the queue.
    pub(super) fn frame_submits(&mut self) {
        self.unflushed_bytes = 0;
        self.is_drawing = true;
    }

    /// Moves the commands to a frame, which submits them before its own.
    pub(super) fn take_commands(&mut self, into: &mut Vec<wgpu::CommandBuffer>) {
        into.append(&mut self.commands);
        self.submitted.append(&mut self.sources);
    }

    /// Submits the commands and polls the device. wgpu frees the staging memory of queue writes, several times their size for
    /// small images, only after a submission and a poll.
    pub(super) fn flush(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) {
        queue.submit(self.commands.drain(..));
        self.submitted.append(&mut self.sources);
        if let Err(error) = device.poll(wgpu::PollType::Poll) {
            log::error!("uploads: {error}");
        }
        self.unflushed_bytes = 0;
        self.is_drawing = false;
    }

    /// Takes the staging buffers whose commands were submitted.
    pub(super) fn drain_submitted(&mut self) -> impl Iterator<Item = wgpu::Buffer> + '_ {
        self.submitted.drain(..)
    }
}
