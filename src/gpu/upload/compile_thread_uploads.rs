//! [`CompileThreadUploads`]: the draw thread's use of a compile thread. The draw thread gives out slots and takes finished
//! batches; it copies nothing itself.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Memory;
use super::budget::CompileBudget;
use super::compile_operation::CompileStats;
use super::compile_thread::{Batch, CompileThread};
use super::operations::Placed;
use super::recorded_uploads::RecordedUploads;
use super::resource_upload::Upload;
use super::upload_progress::UploadProgress;
use crate::gpu::pools::{CompileInfo, Pools};
use crate::sync::OperationQueue;

/// The maximum size of uploads sent to the compile thread and not returned. Further operations wait for their slots.
const MAX_BYTES_IN_FLIGHT: u64 = 32 << 20;
/// The number of batches that may wait for the next frame's submission; the thread has further staging buffers to fill.
const MAX_UNSUBMITTED_BATCHES: usize = 4;
/// A budget of at least this time counts as unlimited.
const UNLIMITED_TIME: Duration = Duration::from_secs(60);
/// The time that a call with an unlimited budget waits for a batch before it submits and polls again.
const BATCH_TIMEOUT: Duration = Duration::from_millis(1);

/// The compile thread of a context.
pub(super) struct CompileThreadUploads {
    thread: CompileThread,
    /// The uploads of one drawable; kept for its memory.
    uploads: VecDeque<Upload>,
}

impl CompileThreadUploads {
    pub(super) fn start(memory: &Memory) -> std::io::Result<Self> {
        Ok(Self { thread: CompileThread::start(memory)?, uploads: VecDeque::new() })
    }

    /// Returns false after the thread has stopped unexpectedly.
    pub(super) fn is_alive(&self) -> bool {
        !self.thread.has_stopped()
    }

    /// Returns the number of operations that the thread has not completed.
    pub(super) fn operations_in_flight(&self) -> usize {
        self.thread.operations_in_flight()
    }

    /// Has the thread run the application's operations.
    pub(super) fn run_operations(&mut self, operations: &Arc<OperationQueue<wgpu::Device>>) {
        self.thread.run_operations(operations);
    }

    /// Gives drawables their slots and takes finished batches, both within the budget. Waits for the thread only if the budget is
    /// unlimited.
    pub(super) fn run(
        &mut self,
        progress: &mut UploadProgress,
        info: &CompileInfo<'_>,
        pools: &mut Pools,
        budget: &CompileBudget,
    ) -> CompileStats {
        let start = Instant::now();
        let is_time_spent = || start.elapsed() >= budget.time;
        let (mut customs, mut batches) = (CompileStats::default(), CompileStats::default());
        self.return_staging(&mut progress.recorded);
        while self.thread.bytes_in_flight() < MAX_BYTES_IN_FLIGHT
            && let Some(placed) = progress.operations.place_next(info, pools, &mut self.uploads)
        {
            self.uploads.drain(..).for_each(|upload| self.thread.send_upload(upload));
            match placed {
                Placed::Drawable { custom_bytes } => {
                    customs.bytes += custom_bytes.unwrap_or(0);
                    customs.slices += u32::from(custom_bytes.is_some());
                }
                Placed::Texture => {}
                Placed::Operation(compiled) => self.thread.send_end(compiled),
            }
            if is_time_spent() {
                break;
            }
        }
        let waits = budget.time >= UNLIMITED_TIME && self.thread.operations_in_flight() > 0;
        while batches.slices == 0 || (batches.bytes < budget.bytes && !is_time_spent()) {
            let timeout = if waits && batches.slices == 0 { BATCH_TIMEOUT } else { Duration::ZERO };
            let Some(batch) = self.thread.receive_batch(timeout) else { break };
            batches.slices += 1;
            batches.bytes += batch.bytes;
            batches.finished += batch.finished.len() as u32;
            take_batch(batch, progress);
        }
        let recorded = &mut progress.recorded;
        // The thread may wait for staging memory, which only this thread's submissions and polls can free.
        let is_starved = batches.slices == 0 && self.thread.operations_in_flight() > 0;
        let is_backlog = !recorded.is_drawing() || recorded.unsubmitted_sources() >= MAX_UNSUBMITTED_BATCHES;
        if waits || (is_starved && is_backlog) {
            recorded.flush(info.device, info.queue);
        } else if is_starved && let Err(error) = info.device.poll(wgpu::PollType::Poll) {
            log::error!("uploads: {error}");
        }
        batches.bytes += customs.bytes;
        batches.slices += customs.slices;
        batches
    }

    /// Waits until the thread has completed all uploads, and submits them. Returns early if the device is lost.
    pub(super) fn finish_all(
        &mut self,
        progress: &mut UploadProgress,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        is_lost: impl Fn() -> bool,
    ) {
        while self.thread.bytes_in_flight() > 0 && self.is_alive() && !is_lost() {
            if let Some(batch) = self.thread.receive_batch(BATCH_TIMEOUT) {
                take_batch(batch, progress);
            }
            progress.recorded.flush(device, queue);
            self.return_staging(&mut progress.recorded);
        }
    }

    /// Returns staging buffers whose commands the adapter has executed to the thread.
    fn return_staging(&mut self, recorded: &mut RecordedUploads) {
        recorded.drain_submitted().for_each(|staging| self.thread.request_map(staging));
        self.thread.return_mapped();
    }
}

fn take_batch(batch: Batch, progress: &mut UploadProgress) {
    progress.operations.finish(batch.finished);
    progress.recorded.push(batch.commands, batch.staging);
    progress.shortage.note(batch.allocation_error);
}
