//! Who draws: the main thread, or one draw thread that owns the graphics context and its renderer.
//!
//! ```text
//! main   | event update cull |--stage 1-->| event update cull |--stage 2-->| waits for stage 1 | ...
//! draw                       | compile draw stage 1 ......... |<--stage 1--| compile draw stage 2
//! ```
//! Commands go through one FIFO channel, so a tile's compile comes before the first frame that draws it and its
//! release after the last. At most [`STAGES_IN_FLIGHT`] stages are on the way; each comes back with its answer
//! and its memory is used again. With [`ThreadingModel::SingleThreaded`] the same commands run inline.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use image::RgbaImage;

use super::ViewerError;
use crate::cull::RenderStage;
use crate::draw::{DrawStats, Environment, FrameClock, Renderer};
use crate::gpu::{CompileBudget, CompileOperation, Compiled, GpuError, GraphicsContext};
use crate::pager::CompileContext;
use crate::scene::{DrawSlot, Drawable};

/// Where drawing happens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ThreadingModel {
    /// Everything on the main thread, in order: the easiest to debug.
    SingleThreaded,
    /// One thread a context; drawing a frame overlaps update and cull of the next.
    #[default]
    DrawThreadPerContext,
}

impl std::fmt::Display for ThreadingModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::SingleThreaded => "SingleThreaded",
            Self::DrawThreadPerContext => "DrawThreadPerContext",
        })
    }
}

impl std::str::FromStr for ThreadingModel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "SingleThreaded" => Ok(Self::SingleThreaded),
            "DrawThreadPerContext" => Ok(Self::DrawThreadPerContext),
            _ => Err(format!("`{text}` is not SingleThreaded or DrawThreadPerContext")),
        }
    }
}

/// Stages that may be on their way to or in the draw thread; one drawing and one waiting.
pub const STAGES_IN_FLIGHT: usize = 2;

/// Commands that may wait before the sender does; many small uploads fit between two frames.
const COMMAND_QUEUE: usize = 1024;

/// Most time for uploads between two frames at once, so that a frame sent after them does not wait longer.
const MOST_COMPILING: Duration = Duration::from_millis(2);

/// Set in the tickets of what the viewer itself compiles (pages that the application made); the rest are the pager's.
const OWN_TICKET: u64 = 1 << 63;

/// One frame's work for the thread that owns the context.
pub struct FrameJob {
    /// What to draw.
    pub stage: RenderStage,
    /// Sun, sky and fog.
    pub environment: Environment,
    /// Times that programs see.
    pub clock: FrameClock,
    /// How much may be uploaded before the frame is drawn.
    pub budget: CompileBudget,
    /// Read the picture back afterwards.
    pub read_back: bool,
    /// Show it in the window; otherwise the next frame draws over it.
    pub present: bool,
    /// The stats overlay, painted over the picture.
    #[cfg(feature = "window")]
    pub overlay: Option<super::overlay::OverlayPaint>,
}

/// What comes back from a [`FrameJob`].
pub struct FrameDone {
    /// The stage, for reuse.
    pub stage: RenderStage,
    /// What was drawn.
    pub stats: Result<DrawStats, GpuError>,
    /// Time to record and submit, milliseconds.
    pub draw_ms: f64,
    /// Time to upload, milliseconds.
    pub compile_ms: f64,
    /// Time to read the picture back, milliseconds.
    pub read_back_ms: f64,
    /// The picture when it was asked for.
    pub image: Option<Result<RgbaImage, GpuError>>,
    /// Most bytes that the pools held so far.
    pub gpu_bytes_peak: u64,
    /// What could not be drawn as it should, each once.
    pub errors: Vec<String>,
}

/// What the thread that owns the context does, in the order sent.
pub enum DrawCommand {
    /// Put drawables into the compile queue.
    Compile(CompileOperation),
    /// Free slots after the last frame that drew them.
    Release(Vec<DrawSlot>),
    /// Upload within a budget, between two frames.
    RunCompiles(CompileBudget),
    /// Upload everything queued, whatever the time; answered by `Reply::Compiled`.
    FinishCompiles,
    /// Upload within the budget and draw; answered by `Reply::Frame`.
    Frame(Box<FrameJob>),
    /// The target has a new size in pixels.
    Resize([u32; 2]),
    /// Read the last picture, offscreen; answered by `Reply::Image`.
    ReadBack,
    /// End the thread.
    Stop,
}

/// Answers, in the order of their commands.
enum Reply {
    Frame(Box<FrameDone>),
    Image(Result<RgbaImage, GpuError>),
    CompilesFinished,
}

/// The context with its renderer and the compiles under way: what one thread owns.
struct DrawSide {
    context: GraphicsContext,
    renderer: Renderer,
    /// A resize that failed; told with the next frame.
    failed: Option<GpuError>,
    /// Made when the first overlay comes.
    #[cfg(feature = "window")]
    overlay: Option<super::overlay::OverlayPainter>,
    /// Shared with the main side, which sends no second [`DrawCommand::RunCompiles`] while this is set.
    running_compiles: Arc<AtomicBool>,
    /// To the main side; never blocks (its length is bounded by what the pager has in flight).
    compiled: Sender<Compiled>,
}

impl DrawSide {
    fn execute(&mut self, command: DrawCommand) -> Option<Reply> {
        match command {
            DrawCommand::Compile(operation) => {
                self.context.compile(operation);
                None
            }
            DrawCommand::Release(slots) => {
                self.context.release(&slots);
                None
            }
            DrawCommand::RunCompiles(budget) => {
                self.context.run_compiles(&budget);
                self.pass_on_compiled();
                self.running_compiles.store(false, Ordering::Release);
                None
            }
            DrawCommand::FinishCompiles => {
                self.finish_compiles();
                Some(Reply::CompilesFinished)
            }
            DrawCommand::Frame(job) => Some(Reply::Frame(Box::new(self.frame(*job)))),
            DrawCommand::Resize(size_px) => {
                self.failed = self.context.resize(size_px).err();
                None
            }
            DrawCommand::ReadBack => Some(Reply::Image(self.renderer.read_back(&mut self.context))),
            DrawCommand::Stop => None,
        }
    }

    fn pass_on_compiled(&mut self) {
        for compiled in self.context.take_compiled() {
            // The main side may be gone while the viewer is dropped.
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

    fn frame(&mut self, job: FrameJob) -> FrameDone {
        let start = Instant::now();
        self.context.run_compiles(&job.budget);
        self.pass_on_compiled();
        let compiled = Instant::now();
        let stats = match self.failed.take() {
            Some(error) => Err(error),
            None => {
                self.renderer.clock = job.clock;
                self.renderer.draw(&mut self.context, &job.stage, &job.environment)
            }
        };
        #[cfg(feature = "window")]
        if let Some(mut paint) = job.overlay {
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
        let read_back = drawn.elapsed();
        if job.present {
            self.context.present();
        }
        FrameDone {
            stage: job.stage,
            stats,
            draw_ms: millis(submitted - compiled),
            compile_ms: millis(compiled - start),
            read_back_ms: if image.is_some() { millis(read_back) } else { 0.0 },
            image,
            gpu_bytes_peak: self.context.bytes_peak(),
            errors: self.renderer.take_errors(),
        }
    }

    #[cfg(feature = "window")]
    fn paint(&mut self, paint: &mut super::overlay::OverlayPaint) {
        let context = &self.context;
        let painter = self
            .overlay
            .get_or_insert_with(|| super::overlay::OverlayPainter::new(context.device(), context.color_format()));
        painter.paint(context.device(), context.queue(), context.color_view(), paint);
    }
}

/// A duration in milliseconds.
pub(super) fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

enum Side {
    Inline(Box<DrawSide>),
    Thread { commands: Sender<DrawCommand>, join: Option<JoinHandle<()>> },
}

/// The main thread's end of a graphics context: sends commands, takes answers, and is what the pager compiles
/// through. Dropping it ends the draw thread once that has done what was sent before.
pub struct ContextHandle {
    id: u32,
    side: Side,
    replies: Receiver<Reply>,
    /// Used inline only: the draw thread has its own end.
    reply_sender: Sender<Reply>,
    compiled: Receiver<Compiled>,
    /// Operations sent whose answers were not taken.
    compiling: usize,
    /// An upload between frames was sent and has not been done.
    running_compiles: Arc<AtomicBool>,
    /// Compiled for the viewer's own pages, until it asks.
    compiled_own: Vec<Compiled>,
    in_flight: usize,
    /// Wait for every upload when the pager asks what is compiled: the blocking mode.
    pub finish_compiles: bool,
    adapter_name: String,
}

impl ContextHandle {
    /// Takes the context; with [`ThreadingModel::DrawThreadPerContext`] it moves to a thread of its own.
    pub fn new(id: u32, mut context: GraphicsContext, threading: ThreadingModel) -> Result<Self, ViewerError> {
        let adapter_name = context.adapter_name();
        let renderer = Renderer::new(&mut context);
        let (compiled_sender, compiled) = crossbeam_channel::unbounded();
        let (reply_sender, replies) = crossbeam_channel::unbounded();
        let running_compiles = Arc::new(AtomicBool::new(false));
        let mut draw_side = DrawSide {
            running_compiles: running_compiles.clone(),
            context,
            renderer,
            failed: None,
            #[cfg(feature = "window")]
            overlay: None,
            compiled: compiled_sender,
        };
        let side = match threading {
            ThreadingModel::SingleThreaded => Side::Inline(Box::new(draw_side)),
            ThreadingModel::DrawThreadPerContext => {
                let (commands, to_do) = crossbeam_channel::bounded(COMMAND_QUEUE);
                let answers = reply_sender.clone();
                let work = move || {
                    for command in to_do {
                        if matches!(command, DrawCommand::Stop) {
                            break;
                        }
                        if draw_side.execute(command).is_some_and(|reply| answers.send(reply).is_err()) {
                            break;
                        }
                    }
                };
                let spawned = std::thread::Builder::new().name(format!("draw {id}")).spawn(work);
                Side::Thread { commands, join: Some(spawned.map_err(ViewerError::Thread)?) }
            }
        };
        // With a thread only that thread may keep a sender, so that its end is noticed.
        let reply_sender = if matches!(side, Side::Inline(_)) { reply_sender } else { crossbeam_channel::bounded(0).0 };
        Ok(Self {
            id,
            side,
            replies,
            reply_sender,
            compiled,
            compiling: 0,
            running_compiles,
            compiled_own: Vec::new(),
            in_flight: 0,
            finish_compiles: false,
            adapter_name,
        })
    }

    /// Name of the adapter that draws.
    pub fn adapter_name(&self) -> &str {
        &self.adapter_name
    }

    /// Stages sent and not yet back.
    pub fn in_flight(&self) -> usize {
        self.in_flight
    }

    /// Sends a frame. The caller sees to [`STAGES_IN_FLIGHT`].
    pub fn frame(&mut self, job: FrameJob) -> Result<(), ViewerError> {
        self.send(DrawCommand::Frame(Box::new(job)))?;
        self.in_flight += 1;
        Ok(())
    }

    /// A frame that came back, if one has.
    pub fn try_done(&mut self) -> Option<Box<FrameDone>> {
        match self.replies.try_recv() {
            Ok(Reply::Frame(done)) => {
                self.in_flight -= 1;
                Some(done)
            }
            _ => None,
        }
    }

    /// Waits a while for the next frame to come back.
    pub fn wait_done_for(&mut self, patience: Duration) -> Result<Option<Box<FrameDone>>, ViewerError> {
        match self.replies.recv_timeout(patience) {
            Ok(Reply::Frame(done)) => {
                self.in_flight -= 1;
                Ok(Some(done))
            }
            Ok(Reply::Image(_) | Reply::CompilesFinished) | Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Waits for the next frame to come back; `None` when none is on its way.
    pub fn wait_done(&mut self) -> Result<Option<Box<FrameDone>>, ViewerError> {
        if self.in_flight == 0 {
            return Ok(None);
        }
        match self.replies.recv() {
            Ok(Reply::Frame(done)) => {
                self.in_flight -= 1;
                Ok(Some(done))
            }
            // Images and finished compiles are taken by those who asked, once no frame is in flight before them.
            Ok(Reply::Image(_) | Reply::CompilesFinished) => Ok(None),
            Err(_) => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Uploads what the application made itself; see [`Self::take_compiled_own`].
    pub(super) fn compile_own(&mut self, number: u32, drawables: Vec<Drawable>) -> Result<(), ViewerError> {
        let ticket = OWN_TICKET | u64::from(number);
        self.compiling += 1;
        self.send(DrawCommand::Compile(CompileOperation { ticket, drawables }))
    }

    /// What was uploaded by [`Self::compile_own`], with its number; called after the pager has taken its own.
    pub(super) fn take_compiled_own(&mut self) -> Vec<(u32, Compiled)> {
        self.compiled_own.drain(..).map(|c| (c.ticket as u32, c)).collect()
    }

    /// The target has a new size.
    pub fn resize(&mut self, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.send(DrawCommand::Resize(size_px))
    }

    /// The picture of the last frame; the caller has taken all frames in flight before.
    pub fn read_back(&mut self) -> Result<RgbaImage, ViewerError> {
        debug_assert_eq!(self.in_flight, 0, "frames in flight would answer first");
        self.send(DrawCommand::ReadBack)?;
        match self.replies.recv() {
            Ok(Reply::Image(image)) => Ok(image?),
            _ => Err(ViewerError::DrawThreadStopped),
        }
    }

    fn send(&mut self, command: DrawCommand) -> Result<(), ViewerError> {
        match &mut self.side {
            Side::Inline(draw_side) => {
                if let Some(reply) = draw_side.execute(command) {
                    self.reply_sender.send(reply).map_err(|_| ViewerError::DrawThreadStopped)?;
                }
                Ok(())
            }
            Side::Thread { commands, .. } => commands.send(command).map_err(|_| ViewerError::DrawThreadStopped),
        }
    }
}

impl CompileContext for ContextHandle {
    fn id(&self) -> u32 {
        self.id
    }

    fn compile(&mut self, op: CompileOperation) {
        self.compiling += 1;
        // A draw thread that has ended shows at the next frame.
        let _ = self.send(DrawCommand::Compile(op));
    }

    /// On a draw thread this waits behind the frames sent before.
    fn run_compiles(&mut self, budget: &CompileBudget) {
        if self.compiling > 0 && !self.running_compiles.swap(true, Ordering::AcqRel) {
            let budget = CompileBudget { time: budget.time.min(MOST_COMPILING), ..*budget };
            // A draw thread that has ended shows at the next frame.
            let _ = self.send(DrawCommand::RunCompiles(budget));
        }
    }

    fn take_compiled(&mut self) -> Vec<Compiled> {
        // Answers come in order, so frames in flight would have to be taken first; the blocking mode has none.
        if self.finish_compiles && self.in_flight == 0 && self.send(DrawCommand::FinishCompiles).is_ok() {
            let _ = self.replies.recv();
        }
        let own = &mut self.compiled_own;
        let for_pager = |c: Compiled| {
            if c.ticket & OWN_TICKET == 0 {
                Some(c)
            } else {
                own.push(c);
                None
            }
        };
        let compiling = &mut self.compiling;
        let came = self.compiled.try_iter().inspect(|_| *compiling = compiling.saturating_sub(1));
        came.filter_map(for_pager).collect()
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        let _ = self.send(DrawCommand::Release(slots));
    }
}

impl Drop for ContextHandle {
    fn drop(&mut self) {
        if let Side::Thread { commands, join } = &mut self.side {
            // The thread does what was sent before; each command ends in bounded time.
            let _ = commands.send(DrawCommand::Stop);
            if let Some(join) = join.take()
                && join.join().is_err()
            {
                log::error!("the draw thread of context {} panicked", self.id);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for model in [ThreadingModel::SingleThreaded, ThreadingModel::DrawThreadPerContext] {
            assert_eq!(model.to_string().parse(), Ok(model));
        }
        assert!("CullDrawThreadPerContext".parse::<ThreadingModel>().is_err());
    }
}
