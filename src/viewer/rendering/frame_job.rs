//! The messages between the main thread and the thread of a device: frames to draw with their results, and other commands.
//!
//! Commands go through one FIFO channel, so that the upload of a tile precedes the first frame that draws it, and its release
//! follows the last one.

use std::sync::Arc;
use std::time::Duration;

use image::RgbaImage;

use crate::cull::RenderStage;
use crate::draw::{DrawStats, FrameClock, ViewChange};
use crate::gpu::{CompileBudget, CompileOperation, GpuError};
use crate::pager::ImageChange;
use crate::scene::{DrawKind, DrawSlot, Environment, Mesh};

/// The work of one frame in one context.
#[derive(Default)]
pub(in crate::viewer) struct FrameJob {
    /// Number of the context.
    pub(in crate::viewer) context: u32,
    pub(in crate::viewer) frame: u32,
    /// A stage with its environment that is drawn instead of those of the cameras; it is returned.
    pub(in crate::viewer) stage: Option<(RenderStage, Environment)>,
    /// Views as a later frame will draw them, whose missing pipelines are ordered.
    pub(in crate::viewer) rehearsals: Vec<(RenderStage, Environment)>,
    /// Leaves out drawables without a pipeline, unless the whole view is drawn in a new way; see
    /// [`NewStates`](crate::viewer::NewStates).
    pub(in crate::viewer) hides_unready: bool,
    /// The times that shader programs see.
    pub(in crate::viewer) clock: FrameClock,
    /// The limit of uploads before the frame is drawn.
    pub(in crate::viewer) budget: CompileBudget,
    /// Reads the image back afterwards.
    pub(in crate::viewer) read_back: bool,
    /// Presents it in the window, together with the other contexts; otherwise the next frame draws over it.
    pub(in crate::viewer) present: bool,
    /// Overlays that are painted over the image, in this order.
    #[cfg(feature = "window")]
    pub(in crate::viewer) overlays: Vec<crate::viewer::overlay::OverlayPaint>,
}

impl FrameJob {
    /// Returns a job of the same frame for another context.
    pub(in crate::viewer) fn again(&self) -> Self {
        let Self { frame, clock, budget, present, .. } = *self;
        Self { frame, clock, budget, present, ..Self::default() }
    }
}

/// The result of a [`FrameJob`].
pub(in crate::viewer) struct FrameDone {
    pub(in crate::viewer) context: u32,
    pub(in crate::viewer) frame: u32,
    /// The job's own stage.
    pub(in crate::viewer) stage: Option<RenderStage>,
    /// The number of pipelines that the views of the job's rehearsals lack; `None` if they were not rehearsed.
    pub(in crate::viewer) missing_pipelines: Option<u32>,
    /// The counters of the draw.
    pub(in crate::viewer) stats: Result<DrawStats, GpuError>,
    /// Milliseconds to record and submit, including the device's contexts before this one.
    pub(in crate::viewer) draw_ms: f64,
    /// Milliseconds of uploads; counted in the first context of a device.
    pub(in crate::viewer) compile_ms: f64,
    /// Milliseconds to read the image back.
    pub(in crate::viewer) read_back_ms: f64,
    /// The image, if the job asked for it.
    pub(in crate::viewer) image: Option<Result<RgbaImage, GpuError>>,
    /// Bytes in use in the pools; counted in the first context of a device.
    pub(in crate::viewer) gpu_bytes: u64,
    /// Bytes allocated by the pools; counted in the first context of a device.
    pub(in crate::viewer) gpu_bytes_allocated: u64,
    /// The largest number of bytes that the pools held so far.
    pub(in crate::viewer) gpu_bytes_peak: u64,
    /// Problems while drawing, each reported once.
    pub(in crate::viewer) errors: Vec<String>,
}

/// Commands for the thread that owns a device, executed in the order sent.
pub(super) enum DrawCommand {
    /// Creates the pipelines for kinds of drawables that will be uploaded.
    Prewarm(Arc<[DrawKind]>),
    /// Creates them at once, however long that takes.
    PrewarmNow(Arc<[DrawKind]>),
    /// Creates the pipelines for a change of views.
    PrewarmChange(Box<ViewChange>),
    /// Sets a pager's share of the budget of the pools.
    SetMaxBytes { owner: u16, max_bytes: u64 },
    /// Puts drawables into the upload queue.
    Compile(CompileOperation),
    /// Cancels uploads of the queue that have not begun.
    CancelCompiles(Vec<u64>),
    /// Replaces the mesh of a drawable from the next frame on.
    Rewrite { slot: DrawSlot, mesh: Arc<Mesh> },
    /// Writes an image to a texture of state sets, in the upload step of the next frame.
    Show(ImageChange),
    /// Frees slots after the last frame that draws them.
    Release(Vec<DrawSlot>),
    /// Sets for how many frames released slots are kept.
    RetainReleased { frames: u32 },
    /// Frees all released slots at once.
    FlushReleased,
    /// Uploads within a budget, between two frames.
    RunCompiles(CompileBudget),
    /// Uploads the whole queue, without a time limit; answered by [`Reply::CompilesFinished`].
    FinishCompiles {
        /// Waits for GPU memory for as long as it takes.
        waits_for_memory: bool,
    },
    /// Uploads within the budget and draws; answered by [`Reply::Frame`].
    Frame(Box<FrameJob>),
    /// Resizes the target of a context.
    Resize { context: u32, size_px: [u32; 2] },
    /// Reads the last image of an offscreen context; answered by [`Reply::Image`].
    ReadBack { context: u32 },
    /// Gets a view of the texture that an offscreen context draws into; answered by [`Reply::ColorView`].
    ColorView { context: u32 },
    /// Sets whether a context waits for the vertical blank.
    SetVsync { context: u32, vsync: bool },
    /// Loses the device as if the driver had lost it.
    #[cfg(feature = "testing")]
    LoseDevice,
    /// Sets the next answers of a window's surface.
    #[cfg(feature = "testing")]
    PretendSurface { context: u32, answers: Vec<crate::gpu::SurfaceAnswer> },
    /// Wakes the thread, which then checks whether it should end.
    Wake,
}

/// Answers of the thread, in the order of the commands.
pub(super) enum Reply {
    Frame(Box<FrameDone>),
    Image(Result<RgbaImage, GpuError>),
    ColorView(Option<wgpu::TextureView>),
    CompilesFinished {
        /// False when the device was lost or there was no memory.
        all: bool,
    },
}

/// Returns a duration in milliseconds, as the results of a frame have them.
pub(in crate::viewer) fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
