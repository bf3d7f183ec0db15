//! [`ViewerConfig`]: the settings with which a viewer is made.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use super::changes::{EnvironmentChanges, NewStates};
use crate::cull::Stereo;
use crate::gpu::{AdapterChoice, CompileBudget, CompilePace, ContextTraits, GraphicsContext};
use crate::pager::PagerConfig;
use crate::scene::CullSettings;
use crate::sync::Operation;
use crate::viewer::camera::FieldOfView;
use crate::viewer::rendering::ThreadingModel;

/// Settings of a viewer. They are read once, when the viewer is made. More than 16 fields: one for each setting.
#[derive(Clone, Debug)]
pub struct ViewerConfig {
    /// Width and height of the first context in pixels.
    pub size_px: [u32; 2],
    /// The threads that cull and draw.
    pub threading: ThreadingModel,
    /// Pins each thread of the model to a core, in turn, leaving the first core to the main thread; OSG's processor
    /// affinity. In the single-threaded model the main thread gets the first core and the pagers the second. Does nothing
    /// on a single core, and where the system does not support it.
    pub cpu_affinity: bool,
    /// The adapter that draws.
    pub adapter: AdapterChoice,
    /// Samples per pixel: 1, 2, 4, 8 or 16, as far as the adapter has them; see [`ContextTraits::samples`].
    pub samples: u32,
    /// Windows wait for the vertical blank; see [`ContextTraits::vsync`].
    pub vsync: bool,
    /// The GPU driver checks every call. For tests; never measure time with it.
    pub validation: bool,
    /// Settings of the pager. With `blocking` each frame waits until everything it wants is resident.
    pub pager: PagerConfig,
    /// Seconds of prefetch: tiles that cameras will need within this time, along their motion or an announced path, are
    /// loaded after those that the last frame lacked. 0 turns prefetching off; the blocking mode never prefetches.
    pub look_ahead_s: f64,
    /// A tile is refined when its error projects to more than this many pixels.
    pub max_sse_px: f64,
    /// How much finer than the resident tiles a tile must be to be loaded on the way to a finer one; see
    /// [`CullSettings::skip_sse_factor`].
    pub skip_sse_factor: f64,
    /// The limit of uploads before a frame is drawn: more completes the image sooner, less keeps frame times even.
    pub compile_budget: CompileBudget,
    /// How the upload budget shrinks while frames are slow.
    pub compile_pace: CompilePace,
    /// Gives each device a thread for uploads; see [`ContextTraits::compile_thread`].
    pub compile_contexts: bool,
    /// When a change of a view's environment takes effect that needs pipelines which do not exist.
    pub environment_changes: EnvironmentChanges,
    /// When drawables are shown that the application adds to the scene graph and whose pipelines do not exist.
    pub new_states: NewStates,
    /// The number of frames whose statistics are kept.
    pub history_frames: usize,
    /// Draws views for two eyes: the master cameras and, by [`Slave::eyes`](super::super::Slave::eyes), their slaves.
    pub stereo: Option<Stereo>,
    /// The field of view of new views' cameras.
    pub field_of_view: FieldOfView,
    /// Alpha bits that the images of contexts must have; see [`ContextTraits::min_alpha_bits`].
    pub min_alpha_bits: u32,
    /// Stencil bits that the adapter must have, 0 to 8.
    pub min_stencil_bits: u32,
    /// The number of contexts that may be open at once.
    pub max_contexts: usize,
    /// Keeps the geometry of pages that the application added after its upload, to upload it again to contexts opened
    /// later and to devices that replace lost ones. Without it such pages are missing there.
    pub keep_drawables: bool,
    /// The number of frames for which the GPU memory of removed drawables is kept after the last frame that draws them; OSG's
    /// `DeleteHandler::setNumFramesToRetainObjects`.
    pub frames_to_retain: u32,
    /// The folder in which compiled pipelines are kept for the next start; `None` keeps none. Useful where the driver has
    /// no cache.
    pub pipeline_cache: Option<PathBuf>,
    /// Runs once for each context when it is opened, on the thread that opens it, and again when another device replaces a
    /// lost one; OSG's realize operation.
    /// [`CompositeViewer::set_realize_operation`](crate::viewer::CompositeViewer::set_realize_operation) sets another one for
    /// later contexts.
    pub realize_operation: Option<Arc<dyn Operation<GraphicsContext>>>,
}

impl Default for ViewerConfig {
    fn default() -> Self {
        Self {
            size_px: [1280, 720],
            threading: ThreadingModel::default(),
            cpu_affinity: false,
            adapter: AdapterChoice::Any,
            samples: 1,
            vsync: true,
            validation: cfg!(debug_assertions),
            pager: PagerConfig::default(),
            look_ahead_s: 1.0,
            max_sse_px: 16.0,
            skip_sse_factor: 1.0,
            compile_budget: CompileBudget { time: Duration::from_millis(3), bytes: 16 << 20 },
            compile_pace: CompilePace::default(),
            compile_contexts: false,
            environment_changes: EnvironmentChanges::default(),
            new_states: NewStates::default(),
            history_frames: 100_000,
            stereo: None,
            field_of_view: FieldOfView::LongerSide(60f64.to_radians()),
            min_alpha_bits: 0,
            min_stencil_bits: 0,
            max_contexts: 32,
            keep_drawables: true,
            frames_to_retain: 0,
            pipeline_cache: None,
            realize_operation: None,
        }
    }
}

impl ViewerConfig {
    /// Returns the traits of the viewer's first context.
    pub fn traits(&self) -> ContextTraits {
        ContextTraits {
            size_px: self.size_px,
            adapter: self.adapter,
            samples: self.samples,
            vsync: self.vsync,
            min_alpha_bits: self.min_alpha_bits,
            compile_thread: self.compile_contexts,
            validation: self.validation,
            ..ContextTraits::default()
        }
    }

    pub(in crate::viewer) fn cull_settings(&self) -> CullSettings {
        CullSettings { max_sse_px: self.max_sse_px, skip_sse_factor: self.skip_sse_factor, ..CullSettings::default() }
    }
}
