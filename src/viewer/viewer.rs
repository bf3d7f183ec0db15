//! The viewer: owns the scene, the pager, the camera and the context, and runs the frame. Main thread.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DAffine3;
use image::RgbaImage;

use super::ViewerError;
use super::camera::Camera;
use super::home::{LoadedRoot, SetBounds, ViewFrom, environment_for, root_volume};
use super::manipulator::{CameraManipulator, Event};
use super::rendering::{Rendering, ThreadingModel};
use super::stats::StatsHistory;
use crate::cull::{CullSettings, CullVisitor, PageRequest, RenderStage, Stereo};
use crate::draw::Environment;
use crate::gpu::{AdapterChoice, CompileBudget, ContextTraits, GraphicsContext};
use crate::io::ReadOptions;
use crate::pager::{CompileContext, DatabasePager, PagerConfig};
use crate::scene::{CameraTarget, Page, PageId, Scene};

/// How a viewer is made.
#[derive(Clone, Debug)]
pub struct ViewerConfig {
    /// Size of the picture in pixels.
    pub size_px: [u32; 2],
    /// Who culls and who draws.
    pub threading: ThreadingModel,
    /// Which adapter draws.
    pub adapter: AdapterChoice,
    /// Samples a pixel, 1 or 4.
    pub samples: u32,
    /// The GPU driver checks every call: for tests, never for timing.
    pub validation: bool,
    /// The pager; with `blocking` each frame waits until everything it wants is there.
    pub pager: PagerConfig,
    /// A tile whose error projects to more pixels is refined.
    pub max_sse_px: f64,
    /// Uploads between two frames: more fills the picture sooner, less keeps frames even.
    pub compile_budget: CompileBudget,
    /// Frames whose statistics are kept.
    pub history_frames: usize,
}

impl Default for ViewerConfig {
    fn default() -> Self {
        Self {
            size_px: [1280, 720],
            threading: ThreadingModel::default(),
            adapter: AdapterChoice::Any,
            samples: 1,
            validation: cfg!(debug_assertions),
            pager: PagerConfig::default(),
            max_sse_px: 16.0,
            compile_budget: CompileBudget { time: Duration::from_millis(3), bytes: 16 << 20 },
            history_frames: 100_000,
        }
    }
}

/// Number and times of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameStamp {
    /// First 1.
    pub frame: u32,
    /// Seconds since the first frame.
    pub reference_time_s: f64,
    /// Seconds in the application's time.
    pub simulation_time_s: f64,
}

/// What an application does to the scene in the update phase of each frame.
pub type UpdateCallback = Box<dyn FnMut(&mut Scene, &FrameStamp) + Send>;

/// A scene, how it is paged, seen and drawn.
///
/// ```text
/// frame()   advance    frame stamp
///           event      events -> manipulator -> camera
///           update     &mut Scene: callbacks, pager (expire, merge, request)
///           rendering  cull: &Scene -> stage; draw: the stage moves to the context's thread;
///                      which threads do it is the [`ThreadingModel`]'s to say
/// ```
pub struct Viewer {
    /// The eye; change it between frames, or set a manipulator.
    pub camera: Camera,
    /// Sun, sky and fog.
    pub environment: Environment,
    /// Uploads between two frames.
    pub compile_budget: CompileBudget,
    #[cfg(feature = "window")]
    pub(super) overlay: Option<super::overlay::OverlayPaint>,
    /// The main thread's alone but while cameras are culled.
    pub(super) scene: Arc<Scene>,
    pub(super) pager: Option<DatabasePager>,
    pub(super) pager_config: PagerConfig,
    /// For looking at the scene outside the frame's own culls, with a stage.
    pub(super) probe: CullVisitor,
    pub(super) probe_stage: RenderStage,
    pub(super) samples: u32,
    pub(super) stereo: Option<Stereo>,
    /// What the eyes' pictures are drawn into; made anew when their size changes.
    pub(super) eyes: Option<[Arc<CameraTarget>; 2]>,
    pub(super) rendering: Rendering,
    pub(super) size_px: [u32; 2],
    /// Of all cameras in the last frame.
    pub(super) requests: Vec<PageRequest>,
    pub(super) manipulator: Option<Box<dyn CameraManipulator>>,
    pub(super) events: Vec<Event>,
    pub(super) update_callbacks: Vec<UpdateCallback>,
    pub(super) bounds: Option<SetBounds>,
    pub(super) root_uri: Option<Arc<str>>,
    pub(super) root: Option<PageId>,
    /// Pages made by the application whose drawables were sent to be uploaded; the index is the ticket.
    pub(super) compiling: Vec<PageId>,
    pub(super) first_frame: Option<Instant>,
    pub(super) last_frame: Option<Instant>,
    pub(super) stamp: FrameStamp,
    /// Seconds between the last two frames.
    pub(super) delta_s: f64,
    pub(super) history: StatsHistory,
    pub(super) gpu_bytes_peak: u64,
    /// What could not be drawn as it should, each once.
    pub(super) draw_errors: Vec<String>,
    pub(super) picture_wanted: bool,
    pub(super) pictures: Vec<(u32, RgbaImage)>,
    /// Reading back in the frame being measured, milliseconds.
    pub(super) read_back_ms: f64,
    /// Frames in a row in which the pager had nothing to do.
    pub(super) quiet_frames: u32,
    pub(super) wanted_missing: u32,
    pub(super) converge_s: Option<f64>,
    pub(super) first_pose: Option<DAffine3>,
}

/// The one context of a viewer.
pub(super) const CONTEXT: u32 = 0;
/// With nothing under way for this many frames, requests that remain are ones the pager declines.
pub(super) const QUIET_FRAMES: u32 = 4;

impl Viewer {
    /// A viewer that draws into a texture.
    pub fn new_offscreen(config: &ViewerConfig) -> Result<Self, ViewerError> {
        Self::new(GraphicsContext::new_offscreen(&traits(config))?, config)
    }

    /// A viewer that draws into a window; called on the thread of the event loop.
    pub fn new_window(
        target: impl Into<wgpu::SurfaceTarget<'static>>,
        config: &ViewerConfig,
    ) -> Result<Self, ViewerError> {
        Self::new(GraphicsContext::new_window(target, &traits(config))?, config)
    }

    /// A viewer on a context of the caller's.
    pub fn new(context: GraphicsContext, config: &ViewerConfig) -> Result<Self, ViewerError> {
        let mut rendering = Rendering::new(ThreadingModel::SingleThreaded);
        let first = rendering.add_context(context);
        debug_assert_eq!(first, CONTEXT);
        rendering.add_camera(first);
        rendering.set_model(config.threading)?;
        for context in rendering.contexts_mut() {
            context.finish_compiles = config.pager.blocking;
        }
        Ok(Self {
            camera: Camera {
                settings: CullSettings { max_sse_px: config.max_sse_px, ..CullSettings::default() },
                ..Camera::default()
            },
            environment: Environment::default(),
            compile_budget: config.compile_budget,
            #[cfg(feature = "window")]
            overlay: None,
            scene: Arc::new(Scene::new()),
            pager: None,
            pager_config: config.pager.clone(),
            probe: CullVisitor::default(),
            probe_stage: RenderStage::new(),
            samples: config.samples,
            stereo: None,
            eyes: None,
            rendering,
            size_px: config.size_px,
            requests: Vec::new(),
            manipulator: None,
            events: Vec::new(),
            update_callbacks: Vec::new(),
            bounds: None,
            root_uri: None,
            root: None,
            compiling: Vec::new(),
            first_frame: None,
            last_frame: None,
            stamp: FrameStamp::default(),
            delta_s: 0.0,
            history: StatsHistory::new(config.history_frames),
            gpu_bytes_peak: 0,
            draw_errors: Vec::new(),
            picture_wanted: false,
            pictures: Vec::new(),
            read_back_ms: 0.0,
            quiet_frames: 0,
            wanted_missing: 0,
            converge_s: None,
            first_pose: None,
        })
    }

    /// Loads a root tile set (folder, file or URL), places the camera at the first view of it and sets sun and
    /// haze to its size. Blocks until the root file is read.
    pub fn load(&mut self, source: &str) -> Result<PageId, ViewerError> {
        self.set_root(LoadedRoot::read(source, &self.pager_config)?)
    }

    /// As [`Self::load`], with a root that was read before there was a viewer.
    pub fn set_root(&mut self, root: LoadedRoot) -> Result<PageId, ViewerError> {
        let LoadedRoot { pager, page, uri, region } = root;
        self.pager = Some(pager);
        self.root_uri = Some(uri);
        let first = self.bounds.is_none();
        let root = self.add_root(page)?;
        if let (true, Some(bounds), Some(region)) = (first, &mut self.bounds, region) {
            *bounds = SetBounds::new(bounds.sphere, Some(region));
        }
        Ok(root)
    }

    /// Adds a page made by the application as a root; paged contents in it are read by the pager of
    /// [`Self::set_pager`]. The first root places the camera.
    pub fn add_root(&mut self, mut page: Page) -> Result<PageId, ViewerError> {
        let bounds = SetBounds::new(page.bounding_sphere(), root_volume(&page));
        if self.bounds.is_none() {
            self.bounds = Some(bounds);
            self.camera.world_from_eye = bounds.first_camera(&ViewFrom::default());
            self.camera.min_near_m = (1e-5 * bounds.sphere.radius_m).clamp(1e-4, 1.0);
            self.environment = environment_for(&bounds);
        }
        let drawables = page.take_drawables();
        let root = self.scene_mut().add_root(page);
        self.root.get_or_insert(root);
        if !drawables.is_empty() {
            self.rendering.compile_own(self.compiling.len() as u32, drawables)?;
            self.compiling.push(root);
        }
        Ok(root)
    }

    /// Takes a root out of the scene and frees what it has on the GPU; `None` when it is not a root, or while
    /// pages hang in it.
    pub fn remove_root(&mut self, id: PageId) -> Option<Page> {
        let mut page = self.scene_mut().remove_root(id)?;
        for (context, slots) in page.take_draw_slots() {
            if let Some(context) = self.rendering.context_mut(context) {
                context.release(slots);
            }
        }
        Some(page)
    }

    /// Pages files in a folder and below, for scenes made by hand.
    pub fn page_files_in(&mut self, folder: &Path) -> Result<(), ViewerError> {
        // The scope of a root is the folder it lies in.
        let root = folder.join("tileset.json").display().to_string();
        let options = ReadOptions::for_root(&root, self.pager_config.limits);
        self.pager = Some(DatabasePager::new(self.pager_config.clone(), options)?);
        Ok(())
    }

    /// Replaces the pager, for scenes made by hand.
    pub fn set_pager(&mut self, pager: DatabasePager) {
        self.pager = Some(pager);
    }

    /// The scene; pages may be added and transforms set between frames.
    pub fn scene_mut(&mut self) -> &mut Scene {
        alone(&mut self.scene)
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The pager, once a set is loaded.
    pub fn pager(&self) -> Option<&DatabasePager> {
        self.pager.as_ref()
    }

    /// Extent of the first root.
    pub fn bounds(&self) -> Option<&SetBounds> {
        self.bounds.as_ref()
    }

    /// URI of the loaded root tile set.
    pub fn root_uri(&self) -> Option<&str> {
        self.root_uri.as_deref()
    }

    /// True when the root tile set holds heights on a shared grid, whose error is in the height alone.
    pub fn is_height_set(&self) -> bool {
        self.root.is_some_and(|root| {
            self.scene.slots_of_page(root).any(|id| self.scene.slot(id).is_some_and(|s| s.reader_data.is_some()))
        })
    }

    /// Size of the picture in pixels.
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// Name of the adapter that draws.
    pub fn adapter_name(&self) -> &str {
        self.rendering.contexts().first().map_or("", |c| c.adapter_name())
    }

    /// Number and times of the last frame.
    pub fn frame_stamp(&self) -> FrameStamp {
        self.stamp
    }

    /// Statistics of the frames so far.
    pub fn stats(&self) -> &StatsHistory {
        &self.history
    }

    /// Seconds from the first frame to the first in which nothing was wanted and nothing pending, if the camera
    /// had not moved by then.
    pub fn converge_s(&self) -> Option<f64> {
        self.converge_s
    }

    /// True when the last frame showed everything it wanted and the pager has nothing to do.
    pub fn is_settled(&self) -> bool {
        self.wanted_missing == 0
            && self.quiet_frames > 0
            && (self.requests.is_empty() || self.quiet_frames >= QUIET_FRAMES)
    }

    /// Moves the camera from now on.
    pub fn set_manipulator(&mut self, manipulator: Option<Box<dyn CameraManipulator>>) {
        self.manipulator = manipulator;
    }

    /// The manipulator, to set its pose.
    pub fn manipulator_mut(&mut self) -> Option<&mut (dyn CameraManipulator + 'static)> {
        self.manipulator.as_deref_mut()
    }

    /// Queues an event for the next frame's event phase.
    pub fn push_event(&mut self, event: Event) {
        self.events.push(event);
    }

    /// Draws for two eyes from now on, or for one.
    pub fn set_stereo(&mut self, stereo: Option<Stereo>) {
        self.stereo = stereo;
        self.eyes = None;
    }

    /// Adds something to do in each update phase.
    pub fn on_update(&mut self, callback: UpdateCallback) {
        self.update_callbacks.push(callback);
    }

    /// The threading model that runs, or will from the first frame on.
    pub fn threading_model(&self) -> ThreadingModel {
        self.rendering.model()
    }

    /// Changes the threading model at run time: waits until all frames are drawn, ends the threads, and the next frame
    /// starts those of the new model.
    pub fn set_threading_model(&mut self, model: ThreadingModel) -> Result<(), ViewerError> {
        self.absorb_all()?;
        self.rendering.set_model(model)
    }

    /// Ends the threads until the next frame starts them again; all frames are drawn before.
    pub fn stop_threading(&mut self) -> Result<(), ViewerError> {
        self.absorb_all()?;
        self.rendering.stop_threads();
        Ok(())
    }

    /// The picture's new size in pixels.
    pub fn resize(&mut self, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.size_px = size_px.map(|side| side.max(1));
        self.eyes = None;
        self.rendering.context_mut(CONTEXT).map_or(Ok(()), |c| c.resize(self.size_px))
    }

    /// Paints an overlay over the next frame.
    #[cfg(feature = "window")]
    pub fn set_overlay(&mut self, paint: super::overlay::OverlayPaint) {
        self.overlay = Some(paint.after(self.overlay.take()));
    }

    /// The next frame's picture is read back; see [`Self::take_pictures`].
    pub fn want_picture(&mut self) {
        self.picture_wanted = true;
    }

    /// Pictures read back so far with their frame numbers, in order.
    pub fn take_pictures(&mut self) -> Vec<(u32, RgbaImage)> {
        std::mem::take(&mut self.pictures)
    }

    /// Renders one frame; the simulation time is the wall's.
    pub fn frame(&mut self) -> Result<(), ViewerError> {
        let now = self.first_frame.map_or(0.0, |first| first.elapsed().as_secs_f64());
        self.frame_at(now)
    }

    /// For a loop with a frame rate of its own, instead of sleeping until the next frame is due: uploads, merges and
    /// expires what arrives, so that frames have less to do. Returns at `deadline`.
    pub fn work_until(&mut self, deadline: Instant) {
        if let (Some(pager), false) = (&mut self.pager, self.pager_config.blocking) {
            pager.work_until(alone(&mut self.scene), &mut self.rendering.compile_contexts(), deadline);
        }
        std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
    }

    /// Waits until every frame has been drawn, so that statistics and pictures are complete.
    pub fn finish(&mut self) -> Result<(), ViewerError> {
        self.absorb_all()
    }

    /// The last frame's picture, offscreen.
    pub fn read_back(&mut self) -> Result<RgbaImage, ViewerError> {
        self.absorb_all()?;
        self.rendering.context_mut(CONTEXT).ok_or(ViewerError::DrawThreadStopped)?.read_back()
    }
}

fn traits(config: &ViewerConfig) -> ContextTraits {
    ContextTraits {
        size_px: config.size_px,
        adapter: config.adapter,
        samples: config.samples,
        validation: config.validation,
    }
}

/// The scene, between two frames.
pub(super) fn alone(scene: &mut Arc<Scene>) -> &mut Scene {
    Arc::get_mut(scene).expect("culls have dropped the scene before a frame ends")
}
