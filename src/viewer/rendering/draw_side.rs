//! [`DrawSide`]: a device with its renderer, its contexts and the compiles under way, what one thread owns; and the
//! commands it takes.
//!
//! Commands go through one FIFO channel, so a tile's compile comes before the first frame that draws it and its release
//! after the last. A frame comes as a command for each context of the device. It names no stage: the stages come from
//! whoever culls, one for each camera.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use image::RgbaImage;

use super::cull_side::{CullSide, Culled};
use super::millis;
use crate::cull::RenderStage;
use crate::draw::{DrawStats, Environment, FrameClock, Picture, Renderer};
use crate::gpu::{CompileBudget, CompileOperation, Compiled, GpuError, GraphicsContext, SurfaceAnswer};
use crate::pager::ImageChange;
use crate::scene::{DrawKind, DrawSlot, Mesh};
use crate::sync::BlockCount;
use crate::sync::primitives::channel::{Receiver, Sender};
use crate::timeline;

/// One frame's work in one context.
#[derive(Default)]
pub(in crate::viewer) struct FrameJob {
    /// Number of the context.
    pub(in crate::viewer) context: u32,
    pub(in crate::viewer) frame: u32,
    /// Drawn instead of what the cameras culled, under a light and a sky; comes back.
    pub(in crate::viewer) stage: Option<(RenderStage, Environment)>,
    /// Times that programs see.
    pub(in crate::viewer) clock: FrameClock,
    /// How much may be uploaded before the frame is drawn.
    pub(in crate::viewer) budget: CompileBudget,
    /// Read the picture back afterwards.
    pub(in crate::viewer) read_back: bool,
    /// Show it in the window, together with the other contexts; otherwise the next frame draws over it.
    pub(in crate::viewer) present: bool,
    /// Painted over the picture, in this order.
    #[cfg(feature = "window")]
    pub(in crate::viewer) overlays: Vec<crate::viewer::overlay::OverlayPaint>,
}

impl FrameJob {
    /// The same frame for another context.
    pub(in crate::viewer) fn again(&self) -> Self {
        let Self { frame, clock, budget, present, .. } = *self;
        Self { frame, clock, budget, present, ..Self::default() }
    }
}

/// What comes back from a [`FrameJob`].
pub(in crate::viewer) struct FrameDone {
    pub(in crate::viewer) context: u32,
    pub(in crate::viewer) frame: u32,
    /// The job's own.
    pub(in crate::viewer) stage: Option<RenderStage>,
    /// What was drawn.
    pub(in crate::viewer) stats: Result<DrawStats, GpuError>,
    /// Time to record and submit, milliseconds, that of the device's contexts before this one included.
    pub(in crate::viewer) draw_ms: f64,
    /// Time to upload, milliseconds; in the first context of its device.
    pub(in crate::viewer) compile_ms: f64,
    /// Time to read the picture back, milliseconds.
    pub(in crate::viewer) read_back_ms: f64,
    /// The picture when it was asked for.
    pub(in crate::viewer) image: Option<Result<RgbaImage, GpuError>>,
    /// Bytes that are taken in the pools; in the first context of their device.
    pub(in crate::viewer) gpu_bytes: u64,
    /// Most bytes that the pools held so far.
    pub(in crate::viewer) gpu_bytes_peak: u64,
    /// What could not be drawn as it should, each once.
    pub(in crate::viewer) errors: Vec<String>,
}

/// What the thread that owns the context does, in the order sent.
pub(super) enum DrawCommand {
    /// Make what the drawables that come need to be drawn.
    Prewarm(Arc<[DrawKind]>),
    /// Put drawables into the compile queue.
    Compile(CompileOperation),
    /// End what has not begun of the compile queue.
    CancelCompiles(Vec<u64>),
    /// Put another mesh in the place of a drawable's, from the next frame on.
    Rewrite { slot: DrawSlot, mesh: Arc<Mesh> },
    /// Write an image to a texture of state sets, in the next frame's compile step.
    Show(ImageChange),
    /// Free slots after the last frame that drew them.
    Release(Vec<DrawSlot>),
    /// Upload within a budget, between two frames.
    RunCompiles(CompileBudget),
    /// Upload everything queued, whatever the time; answered by [`Reply::CompilesFinished`].
    FinishCompiles {
        /// However long there is no memory for it.
        waits_for_memory: bool,
    },
    /// Upload within the budget and draw; answered by [`Reply::Frame`].
    Frame(Box<FrameJob>),
    /// The target of a context has a new size in pixels.
    Resize { context: u32, size_px: [u32; 2] },
    /// Read the last picture of a context, offscreen; answered by [`Reply::Image`].
    ReadBack { context: u32 },
    /// A context waits for the screen, or not.
    SetVsync { context: u32, vsync: bool },
    /// The device goes, as if the driver had lost it.
    LoseDevice,
    /// A window's surface answers so, as if the window system had.
    PretendSurface { context: u32, answers: Vec<SurfaceAnswer> },
    /// Look whether the thread is to end.
    Wake,
}

/// Answers, in the order of their commands.
pub(super) enum Reply {
    Frame(Box<FrameDone>),
    Image(Result<RgbaImage, GpuError>),
    CompilesFinished {
        /// False where the device was lost, or there was no memory.
        all: bool,
    },
}

/// Where a camera's stages come from and go back to.
pub(super) struct DrawEnd {
    /// Number of the camera.
    pub(super) camera: u32,
    pub(super) culled: Receiver<Culled>,
    pub(super) available: Sender<RenderStage>,
}

/// A context of the device.
pub(super) struct DrawnContext {
    /// Its number.
    id: u32,
    /// Its cameras in the order drawn.
    pub(super) cameras: Vec<DrawEnd>,
    /// Memory for the stages of a frame, with whether each completes.
    stages: Vec<Culled>,
    /// A resize that failed; told with the next frame.
    failed: Option<GpuError>,
    /// Each made when the first picture of its overlay comes.
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
            #[cfg(feature = "window")]
            painters: Vec::new(),
        }
    }

    /// Lets the stages be culled into again. One of a camera that is gone has none to go back to.
    fn give_back_stages(&mut self) {
        for culled in self.stages.drain(..) {
            if let Some(camera) = self.cameras.iter().find(|camera| Some(camera.camera) == culled.camera) {
                // As many fit as there are.
                let _ = camera.available.try_send(culled.stage);
            }
        }
    }
}

/// The device with its renderer: what one thread owns.
pub(super) struct DrawSide {
    pub(super) context: GraphicsContext,
    renderer: Renderer,
    /// By place among the device's targets, in which they are drawn one after the other.
    pub(super) contexts: Vec<DrawnContext>,
    pub(super) commands: Receiver<DrawCommand>,
    /// Never blocks: as many are on the way as were asked for.
    replies: Sender<Reply>,
    /// Set by the main side when the thread is to end.
    stopping: Arc<AtomicBool>,
    /// Shared with the main side, which sends no second [`DrawCommand::RunCompiles`] while this is set.
    running_compiles: Arc<AtomicBool>,
    /// To the main side; never blocks (its length is bounded by what the pager has in flight).
    compiled: Sender<Compiled>,
    /// Those cameras that this thread culls too.
    pub(super) culls: Vec<CullSide>,
    /// The main thread waits at it at the end of the frame, in models that overlap frames.
    pub(super) end_of_dynamic: Option<Arc<BlockCount>>,
    /// The frame under way is one of all contexts: their threads meet for it.
    pub(super) meets_others: bool,
    /// The frame that is to be drawn next: a job for each context, or one that brings its stage.
    jobs: Vec<FrameJob>,
    /// Drawn, to be shown.
    drawn: Vec<(Box<FrameDone>, bool)>,
    /// To be shown from the next frame on.
    images: Vec<ImageChange>,
}

/// The main side's channels.
pub(super) struct DrawSideEnds {
    pub(super) commands: Receiver<DrawCommand>,
    pub(super) replies: Sender<Reply>,
    pub(super) stopping: Arc<AtomicBool>,
    pub(super) running_compiles: Arc<AtomicBool>,
    pub(super) compiled: Sender<Compiled>,
}

impl DrawSide {
    /// `first` is the number of the device's first context.
    pub(super) fn new(mut context: GraphicsContext, first: u32, ends: DrawSideEnds) -> Self {
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
            images: Vec::new(),
        }
    }

    fn place_of(&self, context: u32) -> Option<usize> {
        self.contexts.iter().position(|c| c.id == context)
    }

    /// A context of the device.
    pub(super) fn drawn_mut(&mut self, context: u32) -> Option<&mut DrawnContext> {
        self.contexts.iter_mut().find(|c| c.id == context)
    }

    /// Takes a context whose target the device has as its last one.
    pub(super) fn push_context(&mut self, id: u32) {
        self.contexts.push(DrawnContext::new(id));
        debug_assert_eq!(self.contexts.len(), self.context.face_count());
    }

    /// Closes a context, not the last one.
    pub(super) fn remove_context(&mut self, id: u32) {
        if let Some(place) = self.place_of(id) {
            self.contexts.remove(place);
            self.context.remove_face(place);
        }
    }

    /// All that the next frame is made of has come.
    fn has_frame(&self) -> bool {
        self.jobs.len() >= self.contexts.len() || self.jobs.iter().any(|job| job.stage.is_some())
    }

    /// Does what it is told, until it is told to draw a frame or to end.
    pub(super) fn await_frame(&mut self) {
        while !self.has_frame() && !self.stopping.load(Ordering::Acquire) {
            match self.commands.recv() {
                Ok(DrawCommand::Wake) | Err(_) => break,
                Ok(command) => self.execute(command),
            }
        }
        self.meets_others = self.has_frame() && self.jobs.iter().any(|job| job.present);
    }

    /// Does what was left to do when its thread ended; frames that it has not drawn are forgotten.
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
                // As many fit as there are.
                let _ = camera.available.try_send(culled.stage);
            }
        }
    }

    pub(super) fn execute(&mut self, command: DrawCommand) {
        let reply = match command {
            DrawCommand::Prewarm(kinds) => return self.renderer.prewarm(&mut self.context, &kinds),
            DrawCommand::Compile(operation) => return self.context.compile(operation),
            DrawCommand::CancelCompiles(tickets) => {
                self.context.cancel_compiles(&tickets);
                return self.pass_on_compiled();
            }
            DrawCommand::Rewrite { slot, mesh } => {
                if let Err(error) = self.context.rewrite(slot, &mesh) {
                    self.renderer.report_once(error.to_string());
                }
                return;
            }
            DrawCommand::Show(change) => {
                // A frame that was skipped leaves its images behind.
                self.images.retain(|earlier| !Arc::ptr_eq(&earlier.texture, &change.texture));
                return self.images.push(change);
            }
            DrawCommand::Release(slots) => return self.context.release(&slots),
            DrawCommand::RunCompiles(budget) => {
                self.context.run_compiles(&budget);
                self.pass_on_compiled();
                return self.running_compiles.store(false, Ordering::Release);
            }
            DrawCommand::FinishCompiles { waits_for_memory } => {
                Reply::CompilesFinished { all: self.finish_compiles(waits_for_memory) }
            }
            DrawCommand::Frame(job) => return self.jobs.push(*job),
            DrawCommand::Resize { context, size_px } => {
                if let Some(place) = self.select(context) {
                    self.contexts[place].failed = self.context.resize(size_px).err();
                }
                return;
            }
            DrawCommand::SetVsync { context, vsync } => {
                if self.select(context).is_some() {
                    self.context.set_vsync(vsync);
                }
                return;
            }
            DrawCommand::LoseDevice => return self.context.lose_device(),
            DrawCommand::PretendSurface { context, answers } => {
                if self.select(context).is_some() {
                    self.context.pretend_surface(&answers);
                }
                return;
            }
            DrawCommand::ReadBack { context } => {
                self.select(context);
                Reply::Image(self.renderer.read_back(&mut self.context))
            }
            DrawCommand::Wake => return,
        };
        // The main side may be gone while the viewer is dropped.
        let _ = self.replies.send(reply);
    }

    /// Turns to a context's target; its place.
    fn select(&mut self, context: u32) -> Option<usize> {
        let place = self.place_of(context)?;
        self.context.select_face(place);
        Some(place)
    }

    /// Takes a new device where the old one is lost, with nothing uploaded to it; false where it is not lost.
    pub(super) fn renew(&mut self) -> Result<bool, GpuError> {
        if !self.context.is_lost() {
            return Ok(false);
        }
        self.context.reopen()?;
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

    fn pass_on_compiled(&mut self) {
        for compiled in self.context.take_compiled() {
            // As above.
            let _ = self.compiled.send(compiled);
        }
    }

    /// False where something is left that cannot be uploaded now.
    fn finish_compiles(&mut self, waits_for_memory: bool) -> bool {
        let unlimited = CompileBudget { time: Duration::from_secs(3600), bytes: u64::MAX };
        let mut goes_on = true;
        while goes_on && self.context.pending_compiles() > 0 {
            let stats = self.context.run_compiles(&unlimited);
            // Each run does at least one slice of what is pending, but where nothing can be done.
            goes_on = stats.slices > 0
                || stats.finished > 0
                || !(self.context.is_lost() || (self.context.lacks_memory() && !waits_for_memory));
        }
        self.pass_on_compiled();
        goes_on
    }

    /// Culls what this thread culls itself, and draws the frame it was told to draw, if any: the contexts of the device
    /// one after the other.
    pub(super) fn render(&mut self) {
        if !self.has_frame() {
            return;
        }
        let mut jobs = std::mem::take(&mut self.jobs);
        let start = Instant::now();
        if let Some(first) = jobs.first() {
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
            if let Some(place) = self.select(job.context) {
                draw_ms = self.render_context(place, job, std::mem::take(&mut compile_ms), draw_ms);
            }
        }
        // The memory goes on.
        self.jobs = jobs;
    }

    /// Draws one context; `draw_ms` with its own time.
    fn render_context(&mut self, place: usize, mut job: FrameJob, compile_ms: f64, draw_ms: f64) -> f64 {
        let context = &mut self.contexts[place];
        let own_stage = job.stage.is_some();
        match job.stage.take() {
            Some((stage, environment)) => {
                context.stages.push(Culled { camera: None, stage, environment, completes: false });
            }
            None => {
                // Whoever culls ends with sending a stage, or is gone.
                let _span = timeline::span("wait for cull");
                context.stages.extend(context.cameras.iter().filter_map(|camera| camera.culled.recv().ok()));
            }
        }
        let culled = Instant::now();
        self.renderer.timed = (job.context, job.frame);
        let stats = self.draw(place, job.clock);
        self.complete_dynamic(place);
        #[cfg(feature = "window")]
        // egui's renderer panics on a device that is lost; overlays are made anew for the next one.
        if stats.is_ok() && !self.context.is_lost() {
            for paint in &mut job.overlays {
                self.paint(place, paint);
            }
        }
        let submitted = Instant::now();
        if job.read_back {
            // The adapter's work is part of the frame, copying its picture is not.
            let _ = self.context.device().poll(wgpu::PollType::wait_indefinitely());
        }
        let drawn = Instant::now();
        // A window's image can be read until it is presented only; a frame that the window skipped has none.
        let has_picture = stats.as_ref().is_ok_and(|stats| !stats.skipped);
        let image = (job.read_back && has_picture).then(|| self.renderer.read_back(&mut self.context));
        let read_back_ms = if image.is_some() { millis(drawn.elapsed()) } else { 0.0 };
        let errors = self.renderer.take_errors();
        let context = &mut self.contexts[place];
        let stage = if own_stage { context.stages.pop().map(|culled| culled.stage) } else { None };
        context.give_back_stages();
        let draw_ms = draw_ms + millis(submitted - culled);
        let done = FrameDone {
            context: job.context,
            frame: job.frame,
            stage,
            stats,
            draw_ms,
            compile_ms,
            read_back_ms,
            image,
            gpu_bytes: if place == 0 { self.context.bytes_in_use() } else { 0 },
            gpu_bytes_peak: self.context.bytes_peak(),
            errors,
        };
        self.drawn.push((Box::new(done), job.present));
        draw_ms
    }

    fn draw(&mut self, place: usize, clock: FrameClock) -> Result<DrawStats, GpuError> {
        let context = &mut self.contexts[place];
        if let Some(error) = context.failed.take() {
            return Err(error);
        }
        self.renderer.clock = clock;
        if context.stages.is_empty() {
            return Ok(DrawStats::default());
        }
        let pictures = context.stages.iter().map(|c| Picture { stage: &c.stage, environment: &c.environment });
        self.renderer.draw_pictures(&mut self.context, pictures)
    }

    /// Says that what is dynamic was read.
    fn complete_dynamic(&self, place: usize) {
        if let (Some(block), Some(context)) = (&self.end_of_dynamic, self.contexts.get(place)) {
            context.stages.iter().filter(|culled| culled.completes).for_each(|_| block.completed());
        }
    }

    /// Shows what was drawn and tells the main side.
    pub(super) fn swap(&mut self) {
        let mut drawn = std::mem::take(&mut self.drawn);
        for (done, present) in drawn.drain(..) {
            if present && self.select(done.context).is_some() {
                self.context.present();
            }
            let _ = self.replies.send(Reply::Frame(done));
        }
        self.drawn = drawn;
    }

    #[cfg(feature = "window")]
    fn paint(&mut self, place: usize, paint: &mut crate::viewer::overlay::OverlayPaint) {
        let context = &self.context;
        let painters = &mut self.contexts[place].painters;
        let format = context.color_format();
        let painter = crate::viewer::overlay::OverlayPainter::of(painters, paint, context.device(), format);
        painter.paint(context.device(), context.queue(), context.color_view(), paint);
    }
}
