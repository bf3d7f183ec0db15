//! [`DrawSide`]: the graphics context with its renderer and the compiles under way, what one thread owns; and the
//! commands it takes.
//!
//! Commands go through one FIFO channel, so a tile's compile comes before the first frame that draws it and its release
//! after the last. A frame's command names no stage: the stages come from whoever culls, one for each camera.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};
use image::RgbaImage;

use super::cull_side::{CullSide, Culled};
use super::millis;
use crate::cull::RenderStage;
use crate::draw::{DrawStats, Environment, FrameClock, Picture, Renderer};
use crate::gpu::{CompileBudget, CompileOperation, Compiled, GpuError, GraphicsContext};
use crate::pager::ImageChange;
use crate::scene::{DrawKind, DrawSlot, Mesh};
use crate::sync::BlockCount;
use crate::timeline;

/// One frame's work for the thread that owns the context.
#[derive(Default)]
pub(in crate::viewer) struct FrameJob {
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
    /// The stats overlay, painted over the picture.
    #[cfg(feature = "window")]
    pub(in crate::viewer) overlay: Option<crate::viewer::overlay::OverlayPaint>,
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
    pub(in crate::viewer) frame: u32,
    /// The job's own.
    pub(in crate::viewer) stage: Option<RenderStage>,
    /// What was drawn.
    pub(in crate::viewer) stats: Result<DrawStats, GpuError>,
    /// Time to record and submit, milliseconds.
    pub(in crate::viewer) draw_ms: f64,
    /// Time to upload, milliseconds.
    pub(in crate::viewer) compile_ms: f64,
    /// Time to read the picture back, milliseconds.
    pub(in crate::viewer) read_back_ms: f64,
    /// The picture when it was asked for.
    pub(in crate::viewer) image: Option<Result<RgbaImage, GpuError>>,
    /// Bytes that are taken in the pools.
    pub(in crate::viewer) gpu_bytes: u64,
    /// Most bytes that the pools held so far.
    pub(in crate::viewer) gpu_bytes_peak: u64,
    /// What could not be drawn as it should, each once.
    pub(in crate::viewer) errors: Vec<String>,
}

/// What the thread that owns the context does, in the order sent.
pub(super) enum DrawCommand {
    /// Make what the drawables that come need to be drawn.
    Foresee(Arc<[DrawKind]>),
    /// Put drawables into the compile queue.
    Compile(CompileOperation),
    /// Put another mesh in the place of a drawable's, from the next frame on.
    Rewrite { slot: DrawSlot, mesh: Arc<Mesh> },
    /// Write an image to a texture of state sets, in the next frame's compile step.
    Show(ImageChange),
    /// Free slots after the last frame that drew them.
    Release(Vec<DrawSlot>),
    /// Upload within a budget, between two frames.
    RunCompiles(CompileBudget),
    /// Upload everything queued, whatever the time; answered by [`Reply::CompilesFinished`].
    FinishCompiles,
    /// Upload within the budget and draw; answered by [`Reply::Frame`].
    Frame(Box<FrameJob>),
    /// The target has a new size in pixels.
    Resize([u32; 2]),
    /// Read the last picture, offscreen; answered by [`Reply::Image`].
    ReadBack,
    /// Wait for the screen, or not.
    SetVsync(bool),
    /// The device goes, as if the driver had lost it.
    LoseDevice,
    /// Look whether the thread is to end.
    Wake,
}

/// Answers, in the order of their commands.
pub(super) enum Reply {
    Frame(Box<FrameDone>),
    Image(Result<RgbaImage, GpuError>),
    CompilesFinished,
}

/// Where a camera's stages come from and go back to.
pub(super) struct DrawEnd {
    /// Number of the camera.
    pub(super) camera: u32,
    pub(super) culled: Receiver<Culled>,
    pub(super) available: Sender<RenderStage>,
}

/// The context with its renderer: what one thread owns.
pub(super) struct DrawSide {
    pub(super) context: GraphicsContext,
    renderer: Renderer,
    /// A resize that failed; told with the next frame.
    failed: Option<GpuError>,
    /// What else went wrong between frames; told with the next one.
    errors: Vec<String>,
    /// Made when the first overlay comes.
    #[cfg(feature = "window")]
    overlay: Option<crate::viewer::overlay::OverlayPainter>,
    pub(super) commands: Receiver<DrawCommand>,
    /// Never blocks: as many are on the way as were asked for.
    replies: Sender<Reply>,
    /// Set by the main side when the thread is to end.
    stopping: Arc<AtomicBool>,
    /// Shared with the main side, which sends no second [`DrawCommand::RunCompiles`] while this is set.
    running_compiles: Arc<AtomicBool>,
    /// To the main side; never blocks (its length is bounded by what the pager has in flight).
    compiled: Sender<Compiled>,
    /// The context's cameras in the order drawn.
    pub(super) cameras: Vec<DrawEnd>,
    /// Those that this thread culls too.
    pub(super) culls: Vec<CullSide>,
    /// The main thread waits at it at the end of the frame, in models that overlap frames.
    pub(super) end_of_dynamic: Option<Arc<BlockCount>>,
    /// The frame under way is one of all contexts: their threads meet for it.
    pub(super) meets_others: bool,
    /// The frame that is to be drawn next.
    job: Option<Box<FrameJob>>,
    /// Drawn, to be shown.
    drawn: Option<(Box<FrameDone>, bool)>,
    /// To be shown from the next frame on.
    images: Vec<ImageChange>,
    /// Memory for the stages of a frame, with whether each completes.
    stages: Vec<Culled>,
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
    pub(super) fn new(mut context: GraphicsContext, ends: DrawSideEnds) -> Self {
        let renderer = Renderer::new(&mut context);
        let DrawSideEnds { commands, replies, stopping, running_compiles, compiled } = ends;
        Self {
            context,
            renderer,
            failed: None,
            errors: Vec::new(),
            #[cfg(feature = "window")]
            overlay: None,
            commands,
            replies,
            stopping,
            running_compiles,
            compiled,
            cameras: Vec::new(),
            culls: Vec::new(),
            end_of_dynamic: None,
            meets_others: false,
            job: None,
            drawn: None,
            images: Vec::new(),
            stages: Vec::new(),
        }
    }

    /// Does what it is told, until it is told to draw a frame or to end.
    pub(super) fn await_frame(&mut self) {
        while self.job.is_none() && !self.stopping.load(Ordering::Acquire) {
            match self.commands.recv() {
                Ok(DrawCommand::Wake) | Err(_) => break,
                Ok(command) => self.execute(command),
            }
        }
        self.meets_others = self.job.as_ref().is_some_and(|job| job.present);
    }

    /// Does what was left to do when its thread ended; frames that it has not drawn are forgotten.
    pub(super) fn catch_up(&mut self) {
        while let Ok(command) = self.commands.try_recv() {
            self.execute(command);
        }
        (self.job, self.drawn) = (None, None);
        self.stages.clear();
        for camera in &self.cameras {
            while let Ok(culled) = camera.culled.try_recv() {
                // As many fit as there are.
                let _ = camera.available.try_send(culled.stage);
            }
        }
    }

    pub(super) fn execute(&mut self, command: DrawCommand) {
        let reply = match command {
            DrawCommand::Foresee(kinds) => return self.renderer.foresee(&self.context, &kinds),
            DrawCommand::Compile(operation) => return self.context.compile(operation),
            DrawCommand::Rewrite { slot, mesh } => {
                if let Err(error) = self.context.rewrite(slot, &mesh) {
                    self.errors.push(error.to_string());
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
            DrawCommand::FinishCompiles => {
                self.finish_compiles();
                Reply::CompilesFinished
            }
            DrawCommand::Frame(job) => return self.job = Some(job),
            DrawCommand::Resize(size_px) => return self.failed = self.context.resize(size_px).err(),
            DrawCommand::SetVsync(vsync) => return self.context.set_vsync(vsync),
            DrawCommand::LoseDevice => return self.context.lose_device(),
            DrawCommand::ReadBack => Reply::Image(self.renderer.read_back(&mut self.context)),
            DrawCommand::Wake => return,
        };
        // The main side may be gone while the viewer is dropped.
        let _ = self.replies.send(reply);
    }

    /// Takes a new device where the old one is lost, with nothing uploaded to it; false where it is not lost.
    pub(super) fn renew(&mut self) -> Result<bool, GpuError> {
        if !self.context.is_lost() {
            return Ok(false);
        }
        self.context.reopen()?;
        self.renderer = Renderer::new(&mut self.context);
        self.failed = None;
        #[cfg(feature = "window")]
        {
            self.overlay = None;
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

    fn finish_compiles(&mut self) {
        let unlimited = CompileBudget { time: Duration::from_secs(3600), bytes: u64::MAX };
        // Each run does at least one slice of what is pending, so this ends.
        while self.context.pending_compiles() > 0 {
            self.context.run_compiles(&unlimited);
        }
        self.pass_on_compiled();
    }

    /// Culls what this thread culls itself, and draws the frame it was told to draw, if any.
    pub(super) fn render(&mut self) {
        let Some(mut job) = self.job.take() else { return };
        let start = Instant::now();
        self.context.run_compiles(&job.budget);
        self.pass_on_compiled();
        for ImageChange { texture, image } in self.images.drain(..) {
            if let Err(problem) = self.renderer.show_image(&self.context, &texture, &image) {
                self.errors.push(problem);
            }
        }
        let compiled = Instant::now();
        let own_stage = job.stage.is_some();
        match job.stage.take() {
            Some((stage, environment)) => self.stages.push(Culled { stage, environment, completes: false }),
            None => {
                for cull in &mut self.culls {
                    cull.cull();
                }
                // Whoever culls ends with sending a stage, or is gone.
                let _span = timeline::span("wait for cull");
                self.stages.extend(self.cameras.iter().filter_map(|camera| camera.culled.recv().ok()));
            }
        }
        let culled = Instant::now();
        let stats = self.draw(job.clock);
        self.complete_dynamic();
        #[cfg(feature = "window")]
        if let Some(mut paint) = job.overlay.take() {
            self.paint(&mut paint);
        }
        let submitted = Instant::now();
        if job.read_back {
            // The adapter's work is part of the frame, copying its picture is not.
            let _ = self.context.device().poll(wgpu::PollType::wait_indefinitely());
        }
        let drawn = Instant::now();
        // A window's image can be read until it is presented only.
        let image = (job.read_back && stats.is_ok()).then(|| self.renderer.read_back(&mut self.context));
        let read_back_ms = if image.is_some() { millis(drawn.elapsed()) } else { 0.0 };
        let mut errors = self.renderer.take_errors();
        errors.append(&mut self.errors);
        let stage = if own_stage { self.stages.pop().map(|culled| culled.stage) } else { None };
        self.give_back_stages();
        let done = FrameDone {
            frame: job.frame,
            stage,
            stats,
            draw_ms: millis(submitted - culled),
            compile_ms: millis(compiled - start),
            read_back_ms,
            image,
            gpu_bytes: self.context.bytes_in_use(),
            gpu_bytes_peak: self.context.bytes_peak(),
            errors,
        };
        self.drawn = Some((Box::new(done), job.present));
    }

    fn draw(&mut self, clock: FrameClock) -> Result<DrawStats, GpuError> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        self.renderer.clock = clock;
        if self.stages.is_empty() {
            return Ok(DrawStats::default());
        }
        let pictures = self.stages.iter().map(|c| Picture { stage: &c.stage, environment: &c.environment });
        self.renderer.draw_pictures(&mut self.context, pictures)
    }

    /// Says that what is dynamic was read.
    fn complete_dynamic(&self) {
        if let Some(block) = &self.end_of_dynamic {
            self.stages.iter().filter(|culled| culled.completes).for_each(|_| block.completed());
        }
    }

    /// Lets the stages be culled into again.
    fn give_back_stages(&mut self) {
        for (camera, culled) in self.cameras.iter().zip(self.stages.drain(..)) {
            // As many fit as there are.
            let _ = camera.available.try_send(culled.stage);
        }
    }

    /// Shows what was drawn and tells the main side.
    pub(super) fn swap(&mut self) {
        let Some((done, present)) = self.drawn.take() else { return };
        if present {
            self.context.present();
        }
        let _ = self.replies.send(Reply::Frame(done));
    }

    #[cfg(feature = "window")]
    fn paint(&mut self, paint: &mut crate::viewer::overlay::OverlayPaint) {
        let context = &self.context;
        let painter = self.overlay.get_or_insert_with(|| {
            crate::viewer::overlay::OverlayPainter::new(context.device(), context.color_format())
        });
        painter.paint(context.device(), context.queue(), context.color_view(), paint);
    }
}
