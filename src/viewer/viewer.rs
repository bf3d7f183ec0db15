//! The viewer: owns the scene, the pager, the camera and the context, and runs the frame. Main thread.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DAffine3;
use image::RgbaImage;

use super::ViewerError;
use super::camera::Camera;
use super::home::{LoadedRoot, LocalFrame, SetBounds, ViewFrom, environment_for, root_volume};
use super::manipulator::{CameraManipulator, Event};
use super::stats::{FrameStats, StatsHistory};
use super::threading::{ContextHandle, FrameDone, FrameJob, STAGES_IN_FLIGHT, ThreadingModel, millis};
use crate::cull::{CullCamera, CullSettings, CullVisitor, PageRequest, RenderStage, Stereo};
use crate::draw::{Environment, FrameClock};
use crate::gpu::{AdapterChoice, CompileBudget, ContextTraits, GraphicsContext};
use crate::io::ReadOptions;
use crate::pager::{CompileContext, DatabasePager, PagerConfig};
use crate::scene::{Attachment, CameraTarget, Page, PageId, Scene};
use crate::state::{TextureFormat, TextureObject};
use crate::timeline;

/// How a viewer is made.
#[derive(Clone, Debug)]
pub struct ViewerConfig {
    /// Size of the picture in pixels.
    pub size_px: [u32; 2],
    /// Who draws.
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
///           rendering  cull: &Scene -> stage; draw: the stage moves to the context's thread
/// ```
pub struct Viewer {
    /// The eye; change it between frames, or set a manipulator.
    pub camera: Camera,
    /// Sun, sky and fog.
    pub environment: Environment,
    /// Uploads between two frames.
    pub compile_budget: CompileBudget,
    #[cfg(feature = "window")]
    overlay: Option<super::overlay::OverlayPaint>,
    pub(super) scene: Scene,
    pub(super) pager: Option<DatabasePager>,
    pager_config: PagerConfig,
    cull: CullVisitor,
    samples: u32,
    stereo: Option<Stereo>,
    /// What the eyes' pictures are drawn into; made anew when their size changes.
    eyes: Option<[Arc<CameraTarget>; 2]>,
    pub(super) context: ContextHandle,
    pub(super) size_px: [u32; 2],
    pub(super) free_stages: Vec<RenderStage>,
    pub(super) requests: Vec<PageRequest>,
    manipulator: Option<Box<dyn CameraManipulator>>,
    events: Vec<Event>,
    update_callbacks: Vec<UpdateCallback>,
    bounds: Option<SetBounds>,
    root_uri: Option<Arc<str>>,
    root: Option<PageId>,
    /// Pages made by the application whose drawables were sent to be uploaded; the index is the ticket.
    compiling: Vec<PageId>,
    first_frame: Option<Instant>,
    last_frame: Option<Instant>,
    stamp: FrameStamp,
    /// Seconds between the last two frames.
    delta_s: f64,
    pub(super) history: StatsHistory,
    pub(super) threading: ThreadingModel,
    pub(super) gpu_bytes_peak: u64,
    /// What could not be drawn as it should, each once.
    pub(super) draw_errors: Vec<String>,
    picture_wanted: bool,
    pictures: Vec<(u32, RgbaImage)>,
    /// Reading back in the frame being measured, milliseconds.
    read_back_ms: f64,
    /// Frames in a row in which the pager had nothing to do.
    quiet_frames: u32,
    pub(super) wanted_missing: u32,
    pub(super) converge_s: Option<f64>,
    first_pose: Option<DAffine3>,
}

/// The one context of a viewer.
pub(super) const CONTEXT: u32 = 0;
/// With nothing under way for this many frames, requests that remain are ones the pager declines.
const QUIET_FRAMES: u32 = 4;
/// How often arrivals are looked for while the draw thread is busy.
const ARRIVAL_POLL: Duration = Duration::from_micros(300);
/// Rounds of cull and load in one frame of the blocking mode: the deepest tree of tilesets that is followed.
const MAX_BLOCKING_ROUNDS: u32 = 256;

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
        let mut context = ContextHandle::new(CONTEXT, context, config.threading)?;
        context.finish_compiles = config.pager.blocking;
        Ok(Self {
            camera: Camera {
                settings: CullSettings { max_sse_px: config.max_sse_px, ..CullSettings::default() },
                ..Camera::default()
            },
            environment: Environment::default(),
            compile_budget: config.compile_budget,
            #[cfg(feature = "window")]
            overlay: None,
            scene: Scene::new(),
            pager: None,
            pager_config: config.pager.clone(),
            cull: CullVisitor::default(),
            samples: config.samples,
            stereo: None,
            eyes: None,
            context,
            size_px: config.size_px,
            free_stages: (0..=STAGES_IN_FLIGHT).map(|_| RenderStage::default()).collect(),
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
            threading: config.threading,
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
        if self.pager_config.build_kd_trees {
            page.build_kd_trees();
        }
        let drawables = page.take_drawables();
        let root = self.scene.add_root(page);
        self.root.get_or_insert(root);
        if !drawables.is_empty() {
            self.context.compile_own(self.compiling.len() as u32, drawables)?;
            self.compiling.push(root);
        }
        Ok(root)
    }

    /// Takes a root out of the scene and frees what it has on the GPU; `None` when it is not a root, or while
    /// pages hang in it.
    pub fn remove_root(&mut self, id: PageId) -> Option<Page> {
        let mut page = self.scene.remove_root(id)?;
        for (_, slots) in page.take_draw_slots() {
            self.context.release(slots);
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
        &mut self.scene
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
        self.context.adapter_name()
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

    /// The picture's new size in pixels.
    pub fn resize(&mut self, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.size_px = size_px.map(|side| side.max(1));
        self.eyes = None;
        self.context.resize(self.size_px)
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

    /// Renders one frame at a simulation time.
    pub fn frame_at(&mut self, simulation_time_s: f64) -> Result<(), ViewerError> {
        let start = Instant::now();
        self.read_back_ms = 0.0;
        let dt_s = self.advance(start, simulation_time_s);
        let mut stats = FrameStats { frame: self.stamp.frame, ..FrameStats::default() };
        let _frame = timeline::span_of("frame", || self.stamp.frame.to_string().into());

        let span = timeline::span("event");
        self.event(dt_s);
        drop(span);
        let after_event = Instant::now();
        stats.event_ms = millis(after_event - start);

        // Update: everything with &mut Scene.
        let span = timeline::span("update");
        for callback in &mut self.update_callbacks {
            callback(&mut self.scene, &self.stamp);
        }
        if self.pager_config.blocking {
            self.absorb_all()?;
        }
        stats.merge_ms = self.page();
        stats.update_ms = millis(after_event.elapsed());
        drop(span);

        // Rendering: cull now, draw on the context's thread.
        self.wait_for_stage()?;
        let before_cull = Instant::now();
        let mut stage = self.free_stages.pop().unwrap_or_default();
        self.cull_into(&mut stage);
        stats.cull_ms = millis(before_cull.elapsed());
        if self.pager_config.blocking {
            let mut rounds = 0;
            while !self.is_settled() && rounds < MAX_BLOCKING_ROUNDS {
                stats.merge_ms += self.page();
                self.cull_into(&mut stage);
                rounds += 1;
            }
        }
        let counters = &stage.counters;
        stats.tiles_drawn = counters.tiles_drawn;
        stats.tiles_visited = counters.tiles_visited;
        stats.occluded = counters.occluded;
        stats.wanted_missing = counters.wanted_missing;
        self.note_convergence(start);
        self.history.push(stats);
        let job = self.job(stage);
        self.context.frame(job)?;
        while let Some(done) = self.context.try_done() {
            self.absorb(*done)?;
        }
        let frame_ms = (millis(start.elapsed()) - self.read_back_ms).max(0.0);
        if let Some(stats) = self.history.frame_mut(self.stamp.frame) {
            stats.frame_ms = frame_ms;
        }
        Ok(())
    }

    /// For a loop with a frame rate of its own, instead of sleeping until the next frame is due: uploads, merges and
    /// expires what arrives, so that frames have less to do. Returns at `deadline`.
    pub fn work_until(&mut self, deadline: Instant) {
        let _span = timeline::span("between frames");
        if let (Some(pager), false) = (&mut self.pager, self.pager_config.blocking) {
            pager.work_until(&mut self.scene, &mut [&mut self.context], deadline);
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
        self.context.read_back()
    }

    fn advance(&mut self, now: Instant, simulation_time_s: f64) -> f64 {
        let first = *self.first_frame.get_or_insert(now);
        let dt_s = self.last_frame.map_or(0.0, |last| (now - last).as_secs_f64());
        self.last_frame = Some(now);
        self.delta_s = dt_s;
        self.stamp = FrameStamp {
            frame: self.stamp.frame + 1,
            reference_time_s: (now - first).as_secs_f64(),
            simulation_time_s,
        };
        dt_s
    }

    fn event(&mut self, dt_s: f64) {
        if let Some(manipulator) = &mut self.manipulator {
            for event in &self.events {
                manipulator.handle(event);
            }
            self.camera.world_from_eye = manipulator.advance(dt_s);
        }
        self.events.clear();
    }

    /// The pager's turn with the scene; milliseconds.
    fn page(&mut self) -> f64 {
        let start = Instant::now();
        let _span = timeline::span("merge");
        self.merge_own();
        if let Some(pager) = &mut self.pager {
            pager.update_scene_graph(&mut self.scene, self.stamp.frame, &self.requests, &mut [&mut self.context]);
            self.quiet_frames = if pager.is_idle() { self.quiet_frames.saturating_add(1) } else { 0 };
        } else {
            self.quiet_frames = QUIET_FRAMES;
        }
        millis(start.elapsed())
    }

    /// Gives pages that the application made the slots of their uploaded drawables.
    fn merge_own(&mut self) {
        if self.pager.is_none() && !self.compiling.is_empty() {
            // Nobody else takes what is compiled.
            self.context.take_compiled();
        }
        for (number, compiled) in self.context.take_compiled_own() {
            for error in &compiled.errors {
                log::error!("a drawable of a root cannot be drawn: {error}");
            }
            match self.compiling.get(number as usize).and_then(|id| self.scene.page_mut(*id)) {
                Some(page) => page.set_draw_slots(CONTEXT, compiled.slots),
                // Removed meanwhile.
                None => self.context.release(compiled.slots),
            }
        }
    }

    pub(super) fn cull_into(&mut self, stage: &mut RenderStage) {
        let horizon = self.bounds.as_ref().and_then(SetBounds::body);
        let camera = CullCamera { horizon, ..self.camera.cull_camera(self.size_px, self.stamp.frame, CONTEXT) };
        match &self.stereo {
            None => {
                self.cull.cull(&self.scene, &camera, stage);
                // The near plane of this very frame, from what cull has just found.
                stage.camera.clip_from_eye =
                    self.camera.clip_from_eye(self.size_px, self.camera.near_for(stage.near_m));
            }
            Some(stereo) => {
                let samples = self.samples;
                let targets = &*self.eyes.get_or_insert_with(|| eye_targets(stereo.eye_size_px(self.size_px), samples));
                self.cull.cull_stereo(&self.scene, &camera, stereo, targets, stage);
                let near_m = self.camera.near_for(stage.near_m);
                let camera = CullCamera { clip_from_eye: self.camera.clip_from_eye(self.size_px, near_m), ..camera };
                for (eye, of_eye) in stereo.eyes(&camera).iter().zip(&mut stage.pre_render) {
                    of_eye.camera.clip_from_eye = eye.clip_from_eye;
                }
            }
        }
        // The stage goes to the draw thread; its requests stay for the next update.
        std::mem::swap(&mut self.requests, &mut stage.requests);
        self.wanted_missing = stage.counters.wanted_missing;
    }

    fn note_convergence(&mut self, now: Instant) {
        let pose = self.camera.world_from_eye;
        let first_pose = *self.first_pose.get_or_insert(pose);
        if self.converge_s.is_none() && first_pose == pose && self.is_settled() {
            self.converge_s = self.first_frame.map(|first| now.max(first).duration_since(first).as_secs_f64());
        }
    }

    pub(super) fn job(&mut self, stage: RenderStage) -> FrameJob {
        // Over a globe, up is a matter of where one is.
        if let Some(bounds) = self.bounds.filter(|b| b.frame.georeferenced) {
            self.environment.up_in_world = LocalFrame::at(self.camera.eye(), bounds.frame.georeferenced).up();
        }
        FrameJob {
            stage,
            environment: self.environment,
            clock: FrameClock {
                reference_time_s: self.stamp.reference_time_s,
                delta_s: self.delta_s,
                simulation_time_s: self.stamp.simulation_time_s,
            },
            budget: self.compile_budget,
            read_back: std::mem::take(&mut self.picture_wanted),
            present: true,
            #[cfg(feature = "window")]
            overlay: self.overlay.take(),
        }
    }

    fn absorb_next(&mut self) -> Result<(), ViewerError> {
        let start = Instant::now();
        let span = timeline::span("wait for draw");
        let done = self.context.wait_done()?;
        drop(span);
        if let Some(done) = done {
            let waited_ms = millis(start.elapsed());
            self.read_back_ms += done.read_back_ms.min(waited_ms);
            self.absorb(*done)?;
        }
        Ok(())
    }

    /// Waits until a stage is free, merging what arrives meanwhile.
    fn wait_for_stage(&mut self) -> Result<(), ViewerError> {
        let _span = timeline::span("wait for stage");
        while self.context.in_flight() >= STAGES_IN_FLIGHT {
            match &mut self.pager {
                Some(pager) if !self.pager_config.blocking && !pager.is_idle() => {
                    pager.merge_arrived(&mut self.scene, &mut [&mut self.context]);
                    let start = Instant::now();
                    if let Some(done) = self.context.wait_done_for(ARRIVAL_POLL)? {
                        self.read_back_ms += done.read_back_ms.min(millis(start.elapsed()));
                        self.absorb(*done)?;
                    }
                }
                _ => self.absorb_next()?,
            }
        }
        Ok(())
    }

    pub(super) fn absorb_all(&mut self) -> Result<(), ViewerError> {
        while self.context.in_flight() > 0 {
            self.absorb_next()?;
        }
        Ok(())
    }

    fn absorb(&mut self, done: FrameDone) -> Result<(), ViewerError> {
        let frame = done.stage.camera.frame;
        self.gpu_bytes_peak = self.gpu_bytes_peak.max(done.gpu_bytes_peak);
        if self.threading == ThreadingModel::SingleThreaded {
            self.read_back_ms += done.read_back_ms;
        }
        self.free_stages.push(done.stage);
        self.draw_errors.extend(done.errors);
        let drawn = done.stats?;
        if let Some(stats) = self.history.frame_mut(frame) {
            stats.draw_ms = done.draw_ms;
            stats.compile_ms = done.compile_ms;
            stats.gpu_ms = drawn.gpu_ms;
            stats.leaves = drawn.leaves;
            stats.draw_calls = drawn.draw_calls;
            stats.state_changes = drawn.state_changes;
            stats.state_changes_skipped = drawn.state_changes_skipped;
            stats.triangles = drawn.triangles;
            stats.points = drawn.points;
            stats.drawn = true;
        }
        if let Some(image) = done.image {
            self.pictures.push((frame, image?));
        }
        Ok(())
    }
}

/// A texture for each eye.
fn eye_targets(size_px: [u32; 2], samples: u32) -> [Arc<CameraTarget>; 2] {
    ["left eye", "right eye"].map(|name| {
        let texture = TextureObject::target(name, size_px, TextureFormat::Rgba8Srgb);
        Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples, ..CameraTarget::default() })
    })
}

fn traits(config: &ViewerConfig) -> ContextTraits {
    ContextTraits {
        size_px: config.size_px,
        adapter: config.adapter,
        samples: config.samples,
        validation: config.validation,
    }
}
