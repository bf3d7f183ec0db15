//! [`DrawSide`]: a device with its renderer, its contexts and its upload queue, as one thread owns them; and the execution of
//! the commands of `frame_job.rs`.
//!
//! A frame arrives as one command per context of the device. The stages to draw arrive separately from the culls, one per
//! camera.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::cull_side::{CullSide, Culled};
use super::frame_job::{DrawCommand, FrameDone, FrameJob, Reply, millis};
use super::pending_uploads::{PendingUploads, Upload};
use super::retained_slots::RetainedSlots;
use crate::cull::RenderStage;
use crate::draw::{CameraView, DrawStats, FrameClock, Renderer, StageKinds};
use crate::gpu::{CompileBudget, Compiled, GpuError, GraphicsContext};
use crate::pager::ImageChange;
use crate::scene::DrawKind;
use crate::sync::primitives::channel::{Receiver, Sender};
use crate::sync::{BlockCount, Operation, OperationQueue};
use crate::trace;

/// The kinds of drawables of a page, and the stages that were drawn when it arrived: its pipelines are created before it is
/// uploaded.
type PageKinds = (Arc<[DrawKind]>, StageKinds);

/// The draw end of a camera's channels: stages arrive culled and are returned empty.
pub(super) struct DrawEnd {
    /// Number of the camera.
    pub(super) camera: u32,
    pub(super) culled: Receiver<Culled>,
    pub(super) available: Sender<RenderStage>,
}

/// A context of the device.
pub(super) struct DrawnContext {
    /// The number of the context.
    id: u32,
    /// The cameras in the order drawn.
    pub(super) cameras: Vec<DrawEnd>,
    /// The stages of a frame; kept for its memory.
    stages: Vec<Culled>,
    /// The error of a failed resize, reported with the next frame.
    failed: Option<GpuError>,
    /// The application's operations, run after the context is drawn. Other threads add to them.
    pub(super) operations: Arc<OperationQueue<GraphicsContext>>,
    /// One painter per overlay, created with its first frame.
    #[cfg(feature = "window")]
    painters: Vec<crate::viewer::overlay::OverlayPainter>,
}

impl DrawnContext {
    pub(super) fn new(id: u32) -> Self {
        Self {
            id,
            cameras: Vec::new(),
            stages: Vec::new(),
            failed: None,
            operations: Arc::default(),
            #[cfg(feature = "window")]
            painters: Vec::new(),
        }
    }

    /// Returns the stages to their cameras. A stage whose camera was removed is dropped.
    fn give_back_stages(&mut self) {
        for culled in self.stages.drain(..) {
            if let Some(camera) = self.cameras.iter().find(|camera| Some(camera.camera) == culled.camera) {
                // The channel has room for all stages of the camera.
                let _ = camera.available.try_send(culled.stage);
            }
        }
    }
}

/// A device with its renderer, owned by one thread. More than 16 fields: an end of each channel to the main side, and the state of
/// each kind of command.
pub(super) struct DrawSide {
    pub(super) context: GraphicsContext,
    renderer: Renderer,
    /// In the order of the device's targets, which is the order of drawing.
    pub(super) contexts: Vec<DrawnContext>,
    pub(super) commands: Receiver<DrawCommand>,
    /// To the main side; unbounded, with at most one reply per command in flight.
    replies: Sender<Reply>,
    /// Set by the main side when the thread must end.
    stopping: Arc<AtomicBool>,
    /// Shared with the main side, which sends no second [`DrawCommand::RunCompiles`] while this is set.
    running_compiles: Arc<AtomicBool>,
    /// Finished uploads, to the main side; unbounded, with at most as many as the pagers have in flight.
    compiled: Sender<Compiled>,
    /// The cameras that this thread culls itself.
    pub(super) culls: Vec<CullSide>,
    /// The main thread waits here at the end of the frame, in models that overlap frames.
    pub(super) end_of_dynamic: Option<Arc<BlockCount>>,
    /// The current frame is one of all contexts, whose threads meet at barriers.
    pub(super) meets_others: bool,
    /// The jobs of the next frame: one for each context, or a single one with its own stage.
    jobs: Vec<FrameJob>,
    /// Results that are drawn and not yet presented, and whether to present them.
    drawn: Vec<(Box<FrameDone>, bool)>,
    uploads: PendingUploads<PageKinds>,
    /// The pager waits for uploads, so that nothing is gained by creating pipelines on another thread.
    is_blocking: bool,
    /// The number of pipelines in creation when the first of the uploads last had to wait for them.
    pipelines_open: u32,
    /// Images for textures, written in the next frame.
    images: Vec<ImageChange>,
    /// Released drawables that the application wants to be kept for some frames.
    retained: RetainedSlots,
}

/// The ends of the channels that a [`DrawSide`] gets.
pub(super) struct DrawSideEnds {
    pub(super) commands: Receiver<DrawCommand>,
    pub(super) replies: Sender<Reply>,
    pub(super) stopping: Arc<AtomicBool>,
    pub(super) running_compiles: Arc<AtomicBool>,
    pub(super) compiled: Sender<Compiled>,
}

impl DrawSide {
    /// Creates the draw side of a device; `first` is the number of its first context. `is_blocking` means that the pager waits
    /// for uploads.
    pub(super) fn new(mut context: GraphicsContext, first: u32, ends: DrawSideEnds, is_blocking: bool) -> Self {
        let renderer = Renderer::new(&mut context);
        let DrawSideEnds { commands, replies, stopping, running_compiles, compiled } = ends;
        Self {
            context,
            renderer,
            contexts: vec![DrawnContext::new(first)],
            commands,
            replies,
            stopping,
            running_compiles,
            compiled,
            culls: Vec::new(),
            end_of_dynamic: None,
            meets_others: false,
            jobs: Vec::new(),
            drawn: Vec::new(),
            uploads: PendingUploads::default(),
            is_blocking,
            pipelines_open: 0,
            images: Vec::new(),
            retained: RetainedSlots::default(),
        }
    }

    fn index_of(&self, context: u32) -> Option<usize> {
        self.contexts.iter().position(|c| c.id == context)
    }

    /// Returns a context of the device.
    pub(super) fn drawn_mut(&mut self, context: u32) -> Option<&mut DrawnContext> {
        self.contexts.iter_mut().find(|c| c.id == context)
    }

    /// Adds a context for the target that was added to the device last.
    pub(super) fn push_context(&mut self, id: u32) {
        self.contexts.push(DrawnContext::new(id));
        debug_assert_eq!(self.contexts.len(), self.context.target_count());
    }

    /// Closes a context; the device keeps at least one.
    pub(super) fn remove_context(&mut self, id: u32) {
        if let Some(index) = self.index_of(id) {
            self.contexts.remove(index);
            self.context.remove_target(index);
        }
    }

    /// Returns true when all jobs of the next frame have arrived.
    fn has_frame(&self) -> bool {
        self.jobs.len() >= self.contexts.len() || self.jobs.iter().any(|job| job.stage.is_some())
    }

    /// Executes commands until a frame is complete or the thread must end.
    pub(super) fn await_frame(&mut self) {
        while !self.has_frame() && !self.stopping.load(Ordering::Acquire) {
            match self.commands.recv() {
                Ok(DrawCommand::Wake) | Err(_) => break,
                Ok(command) => self.execute(command),
            }
        }
        self.meets_others = self.has_frame() && self.jobs.iter().any(|job| job.present);
    }

    /// Executes the commands that were left when the thread ended; frames that were not drawn are dropped.
    pub(super) fn catch_up(&mut self) {
        while let Ok(command) = self.commands.try_recv() {
            self.execute(command);
        }
        self.jobs.clear();
        self.drawn.clear();
        for context in &mut self.contexts {
            context.stages.clear();
        }
        for camera in self.contexts.iter().flat_map(|context| &context.cameras) {
            while let Ok(culled) = camera.culled.try_recv() {
                // The channel has room for all stages of the camera.
                let _ = camera.available.try_send(culled.stage);
            }
        }
    }

    pub(super) fn execute(&mut self, command: DrawCommand) {
        match command {
            DrawCommand::Prewarm(kinds) => self.prewarm_uploads(kinds),
            DrawCommand::PrewarmNow(kinds) => {
                self.renderer.prewarm(&mut self.context, &kinds);
            }
            DrawCommand::PrewarmChange(change) => self.renderer.prewarm_change(&mut self.context, &change),
            DrawCommand::SetMaxBytes { owner, max_bytes } => self.context.set_max_bytes(owner, max_bytes),
            DrawCommand::Compile(operation) => {
                self.uploads.push(Upload::Compile(operation));
                self.begin_uploads();
            }
            DrawCommand::CancelCompiles(tickets) => self.cancel_compiles(&tickets),
            DrawCommand::Rewrite { slot, mesh } => {
                if let Err(error) = self.context.rewrite(slot, &mesh) {
                    self.renderer.report_once(error.to_string());
                }
            }
            DrawCommand::Show(change) => {
                // After a skipped frame an older image of the texture may still be queued.
                self.images.retain(|earlier| !Arc::ptr_eq(&earlier.texture, &change.texture));
                self.images.push(change);
            }
            DrawCommand::Release(slots) => {
                if let Some(slots) = self.retained.retain(slots) {
                    self.context.release(&slots);
                }
            }
            DrawCommand::RetainReleased { frames } => self.retained.set_frames(frames),
            DrawCommand::FlushReleased => self.flush_released(),
            DrawCommand::RunCompiles(budget) => {
                self.begin_uploads();
                self.context.run_compiles(&budget);
                self.pass_on_compiled();
                self.running_compiles.store(false, Ordering::Release);
            }
            DrawCommand::FinishCompiles { waits_for_memory } => {
                let all = self.finish_compiles(waits_for_memory);
                self.reply(Reply::CompilesFinished { all });
            }
            DrawCommand::Frame(job) => self.jobs.push(*job),
            DrawCommand::Resize { context, size_px } => {
                if let Some(index) = self.select(context) {
                    self.contexts[index].failed = self.context.resize(size_px).err();
                }
            }
            DrawCommand::SetVsync { context, vsync } => {
                if self.select(context).is_some() {
                    self.context.set_vsync(vsync);
                }
            }
            DrawCommand::ReadBack { context } => {
                self.select(context);
                let image = self.renderer.read_back(&mut self.context);
                self.reply(Reply::Image(image));
            }
            DrawCommand::ColorView { context } => {
                self.select(context);
                self.reply(Reply::ColorView(self.context.color_view().cloned()));
            }
            #[cfg(feature = "testing")]
            DrawCommand::LoseDevice => self.context.lose_device(),
            #[cfg(feature = "testing")]
            DrawCommand::PretendSurface { context, answers } => {
                if self.select(context).is_some() {
                    self.context.pretend_surface(&answers);
                }
            }
            DrawCommand::Wake => {}
        }
    }

    fn reply(&self, reply: Reply) {
        // Fails only while the viewer is dropped.
        let _ = self.replies.send(reply);
    }

    /// Has the pipelines of uploads created that follow. The uploads wait for them.
    fn prewarm_uploads(&mut self, kinds: Arc<[DrawKind]>) {
        let stages = self.renderer.stage_kinds(&self.context);
        if !self.is_blocking {
            // In creation while the uploads before are under way.
            self.renderer.order_prewarm(&mut self.context, &kinds, &stages);
        }
        self.uploads.push(Upload::Pipelines((kinds, stages)));
        self.begin_uploads();
    }

    /// Frees all released slots at once, also those that are retained for some frames.
    fn flush_released(&mut self) {
        while let Some(slots) = self.retained.take_any() {
            self.context.release(&slots);
        }
        self.context.flush_released();
    }

    /// Cancels operations by ticket, those that wait behind pipelines included.
    fn cancel_compiles(&mut self, tickets: &[u64]) {
        // The upload queue answers those that have not begun.
        for operation in self.uploads.cancel(tickets) {
            self.context.compile(operation);
        }
        self.context.cancel_compiles(tickets);
        self.pass_on_compiled();
    }

    /// Selects the target of a context, and returns its index.
    fn select(&mut self, context: u32) -> Option<usize> {
        let index = self.index_of(context)?;
        self.context.select_target(index);
        Some(index)
    }

    /// Runs a realize operation for a context that was opened, or whose device was replaced.
    pub(super) fn realize(&mut self, context: u32, operation: &dyn Operation<GraphicsContext>) {
        if self.select(context).is_some() {
            operation.run(&mut self.context);
        }
    }

    /// Replaces the device by a new one without uploads if it is lost; returns false if it is not.
    pub(super) fn renew(&mut self) -> Result<bool, GpuError> {
        if !self.context.is_lost() {
            return Ok(false);
        }
        self.context.reopen()?;
        self.retained.clear();
        self.uploads.clear();
        self.renderer = Renderer::new(&mut self.context);
        for context in &mut self.contexts {
            context.failed = None;
            #[cfg(feature = "window")]
            {
                context.painters.clear();
            }
        }
        self.running_compiles.store(false, Ordering::Release);
        Ok(true)
    }

    /// Passes uploads on to the upload queue, until one needs pipelines that the pipeline thread is still creating: no draw has
    /// to create them.
    fn begin_uploads(&mut self) {
        while let Some(upload) = self.uploads.pop() {
            match upload {
                Upload::Pipelines((kinds, stages)) if self.lacks_pipelines(&kinds, &stages) => {
                    return self.uploads.put_back(Upload::Pipelines((kinds, stages)));
                }
                // Only now, so that pages that wait or are cancelled allocate nothing.
                Upload::Pipelines((kinds, _)) => self.renderer.announce_textures(&mut self.context, &kinds),
                Upload::Compile(operation) => self.context.compile(operation),
            }
        }
    }

    /// Returns true while the pipelines of the first of the uploads are being created.
    fn lacks_pipelines(&mut self, kinds: &[DrawKind], stages: &StageKinds) -> bool {
        if self.is_blocking {
            self.renderer.create_pipelines(&mut self.context, kinds, stages);
            return false;
        }
        // Looked at again when the pipeline thread has created another one.
        let open = self.renderer.pipelines_in_creation();
        let is_unchanged = open > 0 && open == self.pipelines_open;
        self.pipelines_open = open;
        is_unchanged || self.renderer.order_prewarm(&mut self.context, kinds, stages) > 0
    }

    fn pass_on_compiled(&mut self) {
        for compiled in self.context.take_compiled() {
            // Fails only while the viewer is dropped.
            let _ = self.compiled.send(compiled);
        }
    }

    /// Uploads everything; returns false when something is left that cannot be uploaded now.
    fn finish_compiles(&mut self, waits_for_memory: bool) -> bool {
        while let Some(upload) = self.uploads.pop() {
            match upload {
                Upload::Pipelines((kinds, stages)) => {
                    self.renderer.prewarm_for(&mut self.context, &kinds, &stages);
                }
                Upload::Compile(operation) => self.context.compile(operation),
            }
        }
        let unlimited = CompileBudget { time: Duration::from_secs(3600), bytes: u64::MAX };
        let mut makes_progress = true;
        while makes_progress && self.context.pending_compiles() > 0 {
            let stats = self.context.run_compiles(&unlimited);
            // Each run makes progress, unless the device is lost or lacks memory.
            makes_progress = stats.slices > 0
                || stats.finished > 0
                || !(self.context.is_lost() || (self.context.lacks_memory() && !waits_for_memory));
        }
        self.pass_on_compiled();
        makes_progress
    }

    /// Draws the next frame, if there is one: uploads, culls the cameras of this thread, and draws the contexts of the device
    /// one after the other.
    pub(super) fn render(&mut self) {
        if !self.has_frame() {
            return;
        }
        let mut jobs = std::mem::take(&mut self.jobs);
        let start = Instant::now();
        if let Some(first) = jobs.first() {
            self.retained.begin_frame(first.frame);
            while let Some(slots) = self.retained.take_due() {
                self.context.release(&slots);
            }
            self.begin_uploads();
            self.context.run_compiles(&first.budget);
        }
        self.pass_on_compiled();
        for ImageChange { texture, image } in self.images.drain(..) {
            if let Err(problem) = self.renderer.show_image(&self.context, &texture, &image) {
                self.renderer.report_once(problem);
            }
        }
        let (mut compile_ms, mut draw_ms) = (millis(start.elapsed()), 0.0);
        if jobs.iter().all(|job| job.stage.is_none()) {
            for cull in &mut self.culls {
                cull.cull();
            }
        }
        for job in jobs.drain(..) {
            if let Some(index) = self.select(job.context) {
                draw_ms = self.render_context(index, job, std::mem::take(&mut compile_ms), draw_ms);
            }
        }
        // Keeps the memory.
        self.jobs = jobs;
    }

    /// Draws one context; returns `draw_ms` increased by its own time.
    fn render_context(&mut self, index: usize, mut job: FrameJob, compile_ms: f64, draw_ms: f64) -> f64 {
        let context = &mut self.contexts[index];
        let own_stage = job.stage.is_some();
        match job.stage.take() {
            Some((stage, environment)) => {
                context.stages.push(Culled { camera: None, stage, environment, completes: false });
            }
            None => {
                // Each cull ends by sending its stage, unless its thread has died.
                let _span = trace::span("wait for cull");
                context.stages.extend(context.cameras.iter().filter_map(|camera| camera.culled.recv().ok()));
            }
        }
        let culled = Instant::now();
        for (stage, environment) in job.rehearsals {
            self.renderer.rehearse_next(stage, environment);
        }
        self.renderer.timed = (job.context, job.frame);
        self.renderer.hides_unready = job.hides_unready;
        let stats = self.draw(index, job.clock);
        let missing_pipelines = self.renderer.take_rehearsed();
        self.complete_dynamic(index);
        // Not for an image that the application has drawn once more: operations run once in each frame.
        if !own_stage && stats.is_ok() {
            self.contexts[index].operations.run_operations(&mut self.context);
        }
        #[cfg(feature = "window")]
        // egui's renderer panics on a lost device; overlays are created again for the next device.
        if stats.is_ok() && !self.context.is_lost() {
            for paint in &mut job.overlays {
                self.paint(index, paint);
            }
        }
        let submitted = Instant::now();
        if job.read_back {
            // The adapter's work is part of the frame time; the copy of the image is not.
            let _ = self.context.device().poll(wgpu::PollType::wait_indefinitely());
        }
        let drawn = Instant::now();
        // A window's image can be read only until it is presented; a frame that the window skipped has none.
        let has_image = stats.as_ref().is_ok_and(|stats| !stats.skipped);
        let image = (job.read_back && has_image).then(|| self.renderer.read_back(&mut self.context));
        let read_back_ms = if image.is_some() { millis(drawn.elapsed()) } else { 0.0 };
        let errors = self.renderer.take_errors();
        let context = &mut self.contexts[index];
        let stage = if own_stage { context.stages.pop().map(|culled| culled.stage) } else { None };
        context.give_back_stages();
        let draw_ms = draw_ms + millis(submitted - culled);
        let done = FrameDone {
            context: job.context,
            frame: job.frame,
            stage,
            missing_pipelines,
            stats,
            draw_ms,
            compile_ms,
            read_back_ms,
            image,
            gpu_bytes: if index == 0 { self.context.bytes_in_use() } else { 0 },
            gpu_bytes_allocated: if index == 0 { self.context.bytes_allocated() } else { 0 },
            gpu_bytes_peak: self.context.bytes_peak(),
            errors,
        };
        self.drawn.push((Box::new(done), job.present));
        draw_ms
    }

    fn draw(&mut self, index: usize, clock: FrameClock) -> Result<DrawStats, GpuError> {
        let context = &mut self.contexts[index];
        if let Some(error) = context.failed.take() {
            return Err(error);
        }
        self.renderer.clock = clock;
        if context.stages.is_empty() {
            return Ok(DrawStats::default());
        }
        let views = context.stages.iter().map(|c| CameraView { stage: &c.stage, environment: &c.environment });
        self.renderer.draw_views(&mut self.context, views)
    }

    /// Signals that dynamic data was read.
    fn complete_dynamic(&self, index: usize) {
        if let (Some(block), Some(context)) = (&self.end_of_dynamic, self.contexts.get(index)) {
            context.stages.iter().filter(|culled| culled.completes).for_each(|_| block.completed());
        }
    }

    /// Presents the drawn contexts and sends the results to the main side.
    pub(super) fn swap(&mut self) {
        let mut drawn = std::mem::take(&mut self.drawn);
        for (done, present) in drawn.drain(..) {
            if present && self.select(done.context).is_some() {
                self.context.present();
            }
            self.reply(Reply::Frame(done));
        }
        self.drawn = drawn;
    }

    #[cfg(feature = "window")]
    fn paint(&mut self, index: usize, paint: &mut crate::viewer::overlay::OverlayPaint) {
        let context = &self.context;
        let painters = &mut self.contexts[index].painters;
        let format = context.color_format();
        let painter = crate::viewer::overlay::OverlayPainter::of(painters, paint, context.device(), format);
        painter.paint(context.device(), context.queue(), context.color_view(), paint);
    }
}
