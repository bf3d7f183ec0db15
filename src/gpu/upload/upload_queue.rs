//! [`UploadQueue`]: everything that a device has to upload, and the thread that uploads it. Draw thread.

use std::sync::Arc;
use std::time::Instant;

use super::Memory;
use super::budget::CompileBudget;
use super::compile_operation::{CompileOperation, CompileStats, Compiled};
use super::compile_thread_uploads::CompileThreadUploads;
use super::draw_thread_uploads::DrawThreadUploads;
use super::upload_progress::UploadProgress;
use crate::gpu::pools::{CompileInfo, Pools};
use crate::state::TextureObject;
use crate::sync::OperationQueue;
use crate::trace;

/// The thread that copies the data of uploads.
enum Copier {
    DrawThread(DrawThreadUploads),
    CompileThread(CompileThreadUploads),
}

/// The compile operations of a device on their way to the adapter.
pub(in crate::gpu) struct UploadQueue {
    copier: Copier,
    progress: UploadProgress,
}

impl UploadQueue {
    /// Creates a queue whose uploads the draw thread copies.
    pub(in crate::gpu) fn on_draw_thread() -> Self {
        Self::new(Copier::DrawThread(DrawThreadUploads::default()))
    }

    /// Starts a compile thread, and creates a queue whose uploads it copies.
    pub(in crate::gpu) fn with_compile_thread(memory: &Memory) -> std::io::Result<Self> {
        Ok(Self::new(Copier::CompileThread(CompileThreadUploads::start(memory)?)))
    }

    fn new(copier: Copier) -> Self {
        Self { copier, progress: UploadProgress::default() }
    }

    pub(in crate::gpu) fn push(&mut self, operation: CompileOperation) {
        self.progress.operations.push(operation);
    }

    /// Queues the upload of a texture of state sets, before the operations that are pushed later.
    pub(in crate::gpu) fn push_texture(&mut self, object: Arc<TextureObject>, texture: wgpu::Texture) {
        self.progress.operations.push_texture(object, texture);
    }

    /// Takes the textures of state sets whose uploads are submitted with the next frame at the latest.
    pub(in crate::gpu) fn take_textures(&mut self) -> Vec<Arc<TextureObject>> {
        self.progress.operations.take_textures()
    }

    /// Finishes operations that have not begun, without slots.
    pub(in crate::gpu) fn cancel(&mut self, tickets: &[u64]) {
        self.progress.operations.cancel(tickets);
    }

    /// Returns false after the compile thread has stopped unexpectedly.
    pub(in crate::gpu) fn is_alive(&self) -> bool {
        match &self.copier {
            Copier::DrawThread(_) => true,
            Copier::CompileThread(uploads) => uploads.is_alive(),
        }
    }

    /// Returns the number of operations that are waiting or in progress.
    pub(in crate::gpu) fn pending(&self) -> usize {
        self.progress.operations.pending()
            + match &self.copier {
                Copier::DrawThread(_) => 0,
                Copier::CompileThread(uploads) => uploads.operations_in_flight(),
            }
    }

    pub(in crate::gpu) fn take_finished(&mut self) -> Vec<Compiled> {
        self.progress.operations.take_finished()
    }

    /// Uploads within a budget.
    pub(in crate::gpu) fn run(
        &mut self,
        memory: &Memory,
        queue: &wgpu::Queue,
        pools: &mut Pools,
        pipeline_cache: Option<&wgpu::PipelineCache>,
        budget: &CompileBudget,
    ) -> CompileStats {
        let start = Instant::now();
        let device = memory.device();
        // Cloned, since the pools are borrowed mutably beside it.
        let frame_layout = pools.layouts().frame.clone();
        let info = CompileInfo { device, queue, frame_layout: &frame_layout, pipeline_cache };
        let Self { copier, progress } = self;
        let mut stats = match copier {
            Copier::DrawThread(uploads) => uploads.run(progress, memory, &info, pools, budget),
            Copier::CompileThread(uploads) => uploads.run(progress, &info, pools, budget),
        };
        // The operations that need the copies are finished, and what was recorded is submitted before the next frame.
        progress.operations.take_copied().for_each(|copy| pools.copied(&copy));
        progress.recorded.count_bytes(stats.bytes);
        if progress.recorded.is_flush_due() {
            self.flush(device, queue);
        }
        stats.pending = self.pending();
        stats.time = start.elapsed();
        stats
    }

    /// Runs the application's operations: on the compile thread, or here without one.
    pub(in crate::gpu) fn run_operations(&mut self, operations: &Arc<OperationQueue<wgpu::Device>>, memory: &Memory) {
        match &mut self.copier {
            Copier::DrawThread(_) => {
                let _span = trace::span("operations");
                operations.run_operations(&mut memory.device().clone());
            }
            Copier::CompileThread(uploads) => uploads.run_operations(operations),
        }
    }

    fn end_writer(&mut self) {
        if let Copier::DrawThread(uploads) = &mut self.copier {
            uploads.end_writer(&mut self.progress.recorded);
        }
    }

    fn flush(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) {
        self.end_writer();
        self.progress.recorded.flush(device, queue);
    }

    /// Submits the recorded uploads, before a write by the queue: the queue executes its own writes before commands that are
    /// not submitted.
    pub(in crate::gpu) fn flush_recorded(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) {
        let is_writing = matches!(&self.copier, Copier::DrawThread(uploads) if uploads.is_writing());
        if is_writing || !self.progress.recorded.is_empty() {
            self.flush(device, queue);
        }
    }

    /// Moves the recorded uploads to the frame that is about to be submitted. They must be submitted before its own commands.
    pub(in crate::gpu) fn take_commands(&mut self, into: &mut Vec<wgpu::CommandBuffer>) {
        self.progress.recorded.frame_submits();
        self.end_writer();
        self.progress.recorded.take_commands(into);
    }

    /// Completes all uploads that have begun, so that drawables that share their slots can be drawn. Returns early if the
    /// device is lost.
    pub(in crate::gpu) fn finish_uploads(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        is_lost: impl Fn() -> bool,
    ) {
        let Self { copier, progress } = self;
        match copier {
            Copier::DrawThread(uploads) => uploads.finish_all(device, queue),
            Copier::CompileThread(uploads) => {
                uploads.finish_all(progress, device, queue, is_lost);
            }
        }
    }

    /// Takes the error of a shortage of memory that has begun.
    pub(in crate::gpu) fn take_memory_error(&mut self) -> Option<String> {
        self.progress.shortage.take_unreported()
    }

    /// Returns true while uploads wait for memory.
    pub(in crate::gpu) fn lacks_memory(&self) -> bool {
        self.progress.shortage.is_short()
    }
}
