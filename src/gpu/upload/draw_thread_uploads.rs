//! [`DrawThreadUploads`]: uploads by the draw thread itself, in slices within the frame's budget.

use std::collections::VecDeque;
use std::time::Instant;

use super::Memory;
use super::budget::CompileBudget;
use super::compile_operation::CompileStats;
use super::operations::Placed;
use super::recorded_uploads::RecordedUploads;
use super::resource_upload::{QueueSink, Units, Upload};
use super::staging::{StagingPool, StagingWriter};
use super::upload_progress::UploadProgress;
use crate::gpu::pools::{CompileInfo, Pools};

/// The maximum size of a slice: about 100 us of copying, so that the time budget is met closely.
const SLICE_BYTES: u64 = 256 << 10;
/// The size that the first slice of a call may have however small the budget, so that every upload ends.
const MIN_SLICE_BYTES: u64 = 16 << 10;

/// The queued uploads and the staging buffers of a draw thread.
#[derive(Default)]
pub(super) struct DrawThreadUploads {
    /// The uploads of the current operation, the first in progress.
    uploads: VecDeque<Upload>,
    staging: StagingPool,
    /// Fills the current staging buffer.
    writer: Option<StagingWriter>,
    /// Reused memory for converted bytes.
    scratch: Vec<u8>,
}

/// Returns the number of units in the next slice. The first slice of a call has at least one unit.
fn slice_units(remaining: Units, left_bytes: u64, is_first: bool) -> usize {
    let Units { count, unit_bytes } = remaining;
    let max_bytes = if is_first { left_bytes.max(MIN_SLICE_BYTES) } else { left_bytes };
    let fitting = (max_bytes.min(SLICE_BYTES) / unit_bytes.max(1) as u64) as usize;
    // A unit larger than a slice (a row of a huge image) is uploaded alone.
    let fitting = if fitting == 0 && (is_first || unit_bytes as u64 <= max_bytes) { 1 } else { fitting };
    fitting.min(count)
}

impl DrawThreadUploads {
    /// Gives drawables their slots and uploads them until the budget is spent.
    pub(super) fn run(
        &mut self,
        progress: &mut UploadProgress,
        memory: &Memory,
        info: &CompileInfo<'_>,
        pools: &mut Pools,
        budget: &CompileBudget,
    ) -> CompileStats {
        let start = Instant::now();
        let mut stats = CompileStats::default();
        self.staging.take_back(progress.recorded.drain_submitted());
        if progress.operations.pending() == 0 {
            self.staging.trim();
        }
        loop {
            let left_bytes = budget.bytes.saturating_sub(stats.bytes);
            if stats.slices > 0 && (left_bytes == 0 || start.elapsed() >= budget.time) {
                break;
            }
            if let Some(upload) = self.uploads.front() {
                let Some(remaining) = upload.remaining() else {
                    self.uploads.pop_front();
                    continue;
                };
                let count = slice_units(remaining, left_bytes, stats.slices == 0);
                if count == 0 {
                    break;
                }
                let Some(bytes) = self.write_slice(progress, memory, info, count) else { break };
                stats.bytes += bytes;
                stats.slices += u32::from(bytes > 0);
                if self.uploads.front().is_some_and(|upload| upload.remaining().is_none()) {
                    self.uploads.pop_front();
                }
            } else {
                match progress.operations.place_next(info, pools, &mut self.uploads) {
                    Some(Placed::Drawable { custom_bytes }) => {
                        stats.bytes += custom_bytes.unwrap_or(0);
                        stats.slices += u32::from(custom_bytes.is_some());
                    }
                    Some(Placed::Texture) => {}
                    Some(Placed::Operation(compiled)) => {
                        progress.operations.finish([compiled]);
                        stats.finished += 1;
                    }
                    None => break,
                }
            }
        }
        // An operation whose last upload is complete is reported now, not a frame later.
        if self.uploads.is_empty()
            && let Some(compiled) = progress.operations.end_if_placed()
        {
            progress.operations.finish([compiled]);
            stats.finished += 1;
        }
        stats
    }

    /// Writes the next units of the first upload: at most `count`, and at most as many as the staging buffer has room for.
    /// Returns their size in bytes; 0 if the buffer was full and a new one is needed. Returns `None` if there is no memory
    /// for a new buffer; the next frame tries again.
    fn write_slice(
        &mut self,
        progress: &mut UploadProgress,
        memory: &Memory,
        info: &CompileInfo<'_>,
        count: usize,
    ) -> Option<u64> {
        let UploadProgress { recorded, shortage, .. } = progress;
        let Some((upload, unit_bytes)) =
            self.uploads.front_mut().and_then(|upload| upload.remaining().map(|left| (upload, left.unit_bytes)))
        else {
            return Some(0);
        };
        let free_units = |writer: &StagingWriter| writer.free_units(unit_bytes, upload.has_rows());
        // A slice is not split over two buffers, since wgpu clears an image that is written in parts.
        if self.writer.as_ref().is_some_and(|writer| free_units(writer) < count) {
            self.end_writer(recorded);
            if !recorded.is_drawing() {
                recorded.flush(info.device, info.queue);
                self.staging.take_back(recorded.drain_submitted());
            }
            return Some(0);
        }
        if self.writer.is_none() {
            match self.staging.writer(memory, unit_bytes) {
                Ok(writer) => self.writer = writer,
                Err(error) => {
                    shortage.note(Some(error));
                    return None;
                }
            }
            shortage.note(None);
        }
        Some(match &mut self.writer {
            Some(writer) => {
                let count = count.min(free_units(writer));
                upload.write(writer, &mut self.scratch, count)
            }
            None => {
                let mut sink = QueueSink { device: info.device, queue: info.queue };
                upload.write(&mut sink, &mut self.scratch, count)
            }
        })
    }

    /// Ends the current staging buffer and records its commands.
    pub(super) fn end_writer(&mut self, recorded: &mut RecordedUploads) {
        if let Some((commands, source)) = self.writer.take().map(StagingWriter::finish) {
            recorded.push(Some(commands), Some(source));
        }
    }

    /// Returns true if a staging buffer is being filled.
    pub(super) fn is_writing(&self) -> bool {
        self.writer.is_some()
    }

    /// Uploads everything queued by the queue at once.
    pub(super) fn finish_all(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) {
        let mut sink = QueueSink { device, queue };
        self.uploads.drain(..).for_each(|upload| upload.write_all(&mut sink, &mut self.scratch));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_fit_the_budget_except_for_the_first_unit() {
        let units = |count, unit_bytes| Units { count, unit_bytes };
        assert_eq!(slice_units(units(100, 1024), 10 << 10, false), 10);
        assert_eq!(slice_units(units(100, 1024), 0, false), 0);
        assert_eq!(slice_units(units(100, 1024), 0, true), 16, "the first slice has 16 KiB");
        assert_eq!(slice_units(units(5, 1024), u64::MAX, false), 5, "no more than there are");
        assert_eq!(slice_units(units(1000, 1024), u64::MAX, false), 256, "no more than a slice has");
        assert_eq!(slice_units(units(3, 1 << 20), 0, true), 1, "a huge row alone");
        assert_eq!(slice_units(units(3, 1 << 20), 1 << 20, false), 1);
    }
}
