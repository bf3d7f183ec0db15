//! The viewer: one view of one scene, in one context or several. Main thread.

use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use glam::DAffine3;
use image::RgbaImage;

use super::ViewerError;
use super::base::ViewerBase;
use super::home::{LoadedRoot, SetBounds};
use super::input::{GuiActionAdapter, OnPicture, changes, manipulator_view, needs_frame};
use super::manipulators::{CameraManipulator, ManipulatorView};
use super::paged_scene::PagedScene;
use super::rendering::ThreadingModel;
use super::stats::StatsHistory;
use super::view::{ContextId, Slave, SlaveId, View};
use super::viewport::Viewport;
use crate::cull::{CullSettings, Stereo};
use crate::gpu::{AdapterChoice, CompileBudget, CompilePace, ContextTraits, GraphicsContext};
use crate::pager::{DatabasePager, ImagePager, ImageSequence, PagerConfig};
use crate::scene::{Page, PageId, Scene};

/// How a viewer is made.
#[derive(Clone, Debug)]
pub struct ViewerConfig {
    /// Size of the picture in pixels.
    pub size_px: [u32; 2],
    /// Who culls and who draws.
    pub threading: ThreadingModel,
    /// The threads of the model each stay on a core, in turn, leaving the first to the main thread; OSG's processor
    /// affinity. Where the system cannot, they do not.
    pub cpu_affinity: bool,
    /// Which adapter draws.
    pub adapter: AdapterChoice,
    /// Samples a pixel, 1 or 4.
    pub samples: u32,
    /// Windows wait for the screen; see [`ContextTraits::vsync`].
    pub vsync: bool,
    /// The GPU driver checks every call: for tests, never for timing.
    pub validation: bool,
    /// The pager; with `blocking` each frame waits until everything it wants is there.
    pub pager: PagerConfig,
    /// Seconds for which cameras are thought on: what they will lack by then, as they move now or as was announced, is
    /// loaded after all that pictures lack. 0: nothing is. The blocking mode does without.
    pub look_ahead_s: f64,
    /// A tile whose error projects to more pixels is refined.
    pub max_sse_px: f64,
    /// How much finer than what is there a tile must be to be loaded on the way to a finer one, see
    /// [`CullSettings::skip_sse_factor`].
    pub skip_sse_factor: f64,
    /// The most that is uploaded before a frame is drawn: more fills the picture sooner, less keeps frames even.
    pub compile_budget: CompileBudget,
    /// How much of it slow frames leave.
    pub compile_pace: CompilePace,
    /// Each device has a thread of its own for uploads; see [`ContextTraits::compile_thread`].
    pub compile_contexts: bool,
    /// Frames whose statistics are kept.
    pub history_frames: usize,
    /// Views are drawn for two eyes: the master cameras and, as [`Slave::eyes`] says, their slaves.
    pub stereo: Option<Stereo>,
    /// Bits of stencil that the adapter must have; 8 at most.
    pub min_stencil_bits: u32,
    /// Contexts that may be open at once.
    pub max_contexts: usize,
    /// Keep the geometry of pages that the application made after its upload: for contexts that are opened later, and
    /// for a device that takes the place of a lost one. Without it those show such pages no more.
    pub keep_drawables: bool,
    /// Folder in which what the driver compiles is kept for the next start; `None` keeps nothing. Of use where drivers
    /// keep nothing themselves.
    pub pipeline_cache: Option<PathBuf>,
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
            history_frames: 100_000,
            stereo: None,
            min_stencil_bits: 0,
            max_contexts: 1,
            keep_drawables: true,
            pipeline_cache: None,
        }
    }
}

impl ViewerConfig {
    /// What its contexts shall be.
    pub fn traits(&self) -> ContextTraits {
        ContextTraits {
            size_px: self.size_px,
            adapter: self.adapter,
            samples: self.samples,
            vsync: self.vsync,
            compile_thread: self.compile_contexts,
            validation: self.validation,
        }
    }

    pub(super) fn cull_settings(&self) -> CullSettings {
        CullSettings { max_sse_px: self.max_sse_px, skip_sse_factor: self.skip_sse_factor, ..CullSettings::default() }
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

/// A scene, how it is paged, seen and drawn. It is a [`View`] too: its master camera, light and slaves.
///
/// ```text
/// frame()   advance    frame stamp
///           event      queue -> handlers -> manipulator -> event callbacks of nodes, an event at a time
///           update     &mut Scene: callbacks, camera from manipulator, pager (expire, merge, request)
///           rendering  cull: &Scene -> stage; draw: the stage moves to the context's thread;
///                      which threads do it is the [`ThreadingModel`]'s to say
/// ```
pub struct Viewer {
    /// [`ViewerConfig::compile_budget`] from the next frame on.
    pub compile_budget: CompileBudget,
    pub(super) base: ViewerBase,
    pub(super) view: View,
    pub(super) paged: PagedScene,
    /// The context that it was made with.
    pub(super) context: ContextId,
    pub(super) converge_s: Option<f64>,
    first_pose: Option<DAffine3>,
}

impl Deref for Viewer {
    type Target = View;

    fn deref(&self) -> &View {
        &self.view
    }
}

impl DerefMut for Viewer {
    fn deref_mut(&mut self) -> &mut View {
        &mut self.view
    }
}

impl Viewer {
    /// A viewer that draws into a texture.
    pub fn new_offscreen(config: &ViewerConfig) -> Result<Self, ViewerError> {
        Self::new(GraphicsContext::new_offscreen(&config.traits())?, config)
    }

    /// A viewer that draws into a window; called on the thread of the event loop.
    pub fn new_window(
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        config: &ViewerConfig,
    ) -> Result<Self, ViewerError> {
        Self::new(GraphicsContext::new_window(target, &config.traits())?, config)
    }

    /// A viewer on a context of the caller's.
    pub fn new(context: GraphicsContext, config: &ViewerConfig) -> Result<Self, ViewerError> {
        let mut base = ViewerBase::new(config)?;
        let context = base.open_context(context, &mut [])?;
        let mut view = View::new(0, config.cull_settings(), config.size_px, config.samples);
        view.master = Some(base.add_camera(context, Viewport::Whole)?);
        view.set_stereo(config.stereo);
        let pager = base.add_pager(0, None);
        let paged = PagedScene::new(0, pager, config.pager.clone(), config.keep_drawables);
        let compile_budget = config.compile_budget;
        Ok(Self { compile_budget, base, view, paged, context, converge_s: None, first_pose: None })
    }

    /// Loads a root tile set (folder, file or URL) into a scene that shows none, places the camera at the first view of
    /// it and sets sun and haze to its size. Blocks until the root file is read.
    pub fn load(&mut self, source: &str) -> Result<PageId, ViewerError> {
        self.set_root(LoadedRoot::read(source, &self.paged.pager_config)?)
    }

    /// As [`Self::load`], with a root that was read before there was a viewer.
    pub fn set_root(&mut self, root: LoadedRoot) -> Result<PageId, ViewerError> {
        let root = self.base.set_root(std::slice::from_mut(&mut self.paged), 0, root)?;
        self.actions().first_sight();
        Ok(root)
    }

    /// Adds a page made by the application as a root; paged contents in it are read by the pager of
    /// [`Self::set_pager`]. The first root places the camera.
    pub fn add_root(&mut self, page: Page) -> Result<PageId, ViewerError> {
        let is_first = self.paged.bounds.is_none();
        let root = self.paged.add_root(page, &mut self.base.rendering)?;
        if is_first {
            self.actions().first_sight();
        }
        Ok(root)
    }

    /// Takes a root out of the scene and frees what it has on the GPU; `None` when it is not a root, or while
    /// pages hang in it. Added again, the page is drawn as before; without [`ViewerConfig::keep_drawables`] it comes
    /// back without its drawables, and shows nothing any more.
    pub fn remove_root(&mut self, id: PageId) -> Option<Page> {
        self.paged.remove_root(id, &mut self.base.rendering)
    }

    /// Pages files in a folder and below, for scenes made by hand.
    pub fn page_files_in(&mut self, folder: &Path) -> Result<(), ViewerError> {
        let pager = self.paged.pager_of_files(folder)?;
        self.base.set_pager(std::slice::from_mut(&mut self.paged), 0, pager)
    }

    /// Replaces the pager, for scenes made by hand. What the one before merged goes.
    pub fn set_pager(&mut self, pager: DatabasePager) {
        self.base.replace_pager(&mut self.paged, pager);
    }

    /// The scene; pages may be added and transforms set between frames.
    pub fn scene_mut(&mut self) -> &mut Scene {
        self.paged.scene_mut()
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        self.paged.scene()
    }

    /// The pager, once a set is loaded.
    pub fn pager(&self) -> Option<&DatabasePager> {
        self.base.pager_of(&self.paged).pager()
    }

    /// The pager, to pause it or to have it take no new requests.
    pub fn pager_mut(&mut self) -> Option<&mut DatabasePager> {
        self.base.pagers[self.paged.pager].pager_mut()
    }

    /// Takes every page that the pager merged out of the scene and forgets what was asked for; what is wanted is loaded
    /// anew from the next frame on.
    pub fn clear_pages(&mut self) {
        self.base.clear_pages(std::slice::from_mut(&mut self.paged), 0);
    }

    /// Lets a sequence's texture show its images over simulation time; see [`ImageSequence`].
    pub fn add_image_sequence(&mut self, sequence: &ImageSequence) -> Result<(), ViewerError> {
        self.paged.add_image_sequence(sequence)
    }

    /// Replaces the image pager; sequences that the one before had are to be added again.
    pub fn set_image_pager(&mut self, pager: ImagePager) {
        self.paged.image_pager = Some(pager);
    }

    /// The image pager, once a sequence was added.
    pub fn image_pager(&self) -> Option<&ImagePager> {
        self.paged.image_pager.as_ref()
    }

    /// Extent of the tile set that was loaded; without one, of the first root.
    pub fn bounds(&self) -> Option<&SetBounds> {
        self.paged.bounds.as_ref()
    }

    /// URI of the loaded root tile set; `None` once it was removed.
    pub fn root_uri(&self) -> Option<&str> {
        self.paged.root_uri()
    }

    /// True when the root tile set holds heights on a shared grid, whose error is in the height alone.
    pub fn is_height_set(&self) -> bool {
        self.paged.is_height_set()
    }

    /// Name of the adapter that draws.
    pub fn adapter_name(&self) -> &str {
        self.base.rendering.adapter_name()
    }

    /// Number and times of the last frame.
    pub fn frame_stamp(&self) -> FrameStamp {
        self.base.stamp
    }

    /// Statistics of the frames so far.
    pub fn stats(&self) -> &StatsHistory {
        &self.base.history
    }

    /// Seconds from the first frame to the first in which nothing was wanted and nothing pending, if the camera
    /// had not moved by then.
    pub fn converge_s(&self) -> Option<f64> {
        self.converge_s
    }

    /// True when the last frame showed everything it wanted, no level of detail gave way to another, and the pager
    /// has nothing to do.
    pub fn is_settled(&self) -> bool {
        self.base.pager_of(&self.paged).is_at_rest(std::slice::from_ref(&self.paged))
    }

    /// Adds something to do in each update phase.
    pub fn on_update(&mut self, callback: UpdateCallback) {
        self.paged.update_callbacks.push(callback);
    }

    /// The threading model that runs, or will from the first frame on.
    pub fn threading_model(&self) -> ThreadingModel {
        self.base.rendering.model()
    }

    /// Changes the threading model at run time: waits until all frames are drawn, ends the threads, and the next frame
    /// starts those of the new model.
    pub fn set_threading_model(&mut self, model: ThreadingModel) -> Result<(), ViewerError> {
        self.base.absorb_all()?;
        self.base.rendering.set_model(model)
    }

    /// Starts the model's threads; the first frame does otherwise.
    pub fn start_threading(&mut self) -> Result<(), ViewerError> {
        self.base.rendering.start_threads()
    }

    /// Ends the threads until the next frame starts them again; all frames are drawn before.
    pub fn stop_threading(&mut self) -> Result<(), ViewerError> {
        self.base.absorb_all()?;
        self.base.rendering.stop_threads();
        Ok(())
    }

    /// Takes another context with a device of its own, to draw slaves in; at most [`ViewerConfig::max_contexts`]. The
    /// application's pages are uploaded to it; paged contents are loaded anew, for all contexts
    /// ([`Self::open_offscreen_on`] does without). The threads are stopped, and started again by the next frame.
    pub fn open_context(&mut self, context: GraphicsContext) -> Result<ContextId, ViewerError> {
        self.base.open_context(context, std::slice::from_mut(&mut self.paged))
    }

    /// Opens an offscreen context on the device of another one, to draw slaves in: pools, textures and pipelines are the
    /// same objects, so that nothing is uploaded or loaded again, and bytes count once. The contexts of a device are
    /// drawn by one thread, one after the other, in every threading model. Of the traits size, samples and vsync count,
    /// the rest is the device's.
    pub fn open_offscreen_on(&mut self, other: ContextId, traits: &ContextTraits) -> Result<ContextId, ViewerError> {
        self.base.open_context_on(other, traits, GraphicsContext::add_offscreen)
    }

    /// As [`Self::open_offscreen_on`], a window; called on the thread of the event loop. An error where the device's
    /// adapter cannot show anything in it.
    pub fn open_window_on(
        &mut self,
        other: ContextId,
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        traits: &ContextTraits,
    ) -> Result<ContextId, ViewerError> {
        self.base.open_context_on(other, traits, |context, traits| context.add_window(target, traits))
    }

    /// Closes a context, and with it the cameras that are drawn in it; the rest goes on. False when there is none.
    pub fn close_context(&mut self, id: ContextId) -> Result<bool, ViewerError> {
        self.base.close_context(id, std::slice::from_mut(&mut self.view), std::slice::from_mut(&mut self.paged))
    }

    /// The open contexts, in the order opened.
    pub fn contexts(&self) -> impl Iterator<Item = ContextId> {
        self.base.rendering.context_ids().map(ContextId)
    }

    /// Adds a camera that goes with the master camera; drawn after those of its context that are there.
    pub fn add_slave(&mut self, slave: Slave) -> Result<SlaveId, ViewerError> {
        self.base.add_slave(&mut self.view, slave)
    }

    /// Takes a slave out; false when there is none.
    pub fn remove_slave(&mut self, id: SlaveId) -> Result<bool, ViewerError> {
        self.base.remove_slave(&mut self.view, id)
    }

    /// The new size in pixels of the picture, in the context that the viewer was made with.
    pub fn resize(&mut self, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.resize_context(self.context, size_px)
    }

    /// The new size of a context in pixels.
    pub fn resize_context(&mut self, context: ContextId, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.base.resize(context, size_px)?;
        self.view.redraw_in(context);
        self.view.prepare(&self.base.rendering, self.paged.bounds.as_ref());
        Ok(())
    }

    /// A context's window waits for the screen, or not; see [`ContextTraits::vsync`].
    pub fn set_vsync(&mut self, context: ContextId, vsync: bool) -> Result<(), ViewerError> {
        self.base.set_vsync(context, vsync)
    }

    /// Loses a context's device, for tests of what comes after.
    #[doc(hidden)]
    pub fn lose_device(&mut self, context: ContextId) -> Result<(), ViewerError> {
        self.base.lose_device(context)
    }

    /// What the surface of a context's window answers next, for tests of what comes after.
    #[doc(hidden)]
    pub fn pretend_surface(
        &mut self,
        context: ContextId,
        answers: &[crate::gpu::SurfaceAnswer],
    ) -> Result<(), ViewerError> {
        self.base.pretend_surface(context, answers)
    }

    /// What handlers are given.
    pub fn actions(&mut self) -> GuiActionAdapter<'_> {
        GuiActionAdapter { base: &mut self.base, view: &mut self.view, paged: &mut self.paged }
    }

    /// Moves the camera from now on, starting from where it is.
    pub fn set_manipulator(&mut self, manipulator: Option<Box<dyn CameraManipulator>>) {
        self.actions().set_manipulator(manipulator);
    }

    /// Does something with the manipulator, which is told what there is; `None` without one.
    pub fn with_manipulator<R>(
        &mut self,
        act: impl FnOnce(&mut dyn CameraManipulator, &ManipulatorView<'_>) -> R,
    ) -> Option<R> {
        self.actions().with_manipulator(act)
    }

    /// What manipulators are told.
    pub fn manipulator_view(&self) -> ManipulatorView<'_> {
        manipulator_view(&self.view, &self.paged)
    }

    /// Places the camera where the bounds fill the picture; a manipulator goes on from its own home.
    pub fn home(&mut self) {
        self.actions().home();
    }

    /// Places the camera; a manipulator goes on from there. What is not finite changes nothing.
    pub fn set_pose(&mut self, world_from_eye: &DAffine3) {
        self.actions().set_pose(world_from_eye);
    }

    /// Reads back the picture of the frame that comes next, for `then`, besides those of [`Self::want_picture`].
    pub fn capture(&mut self, then: OnPicture) {
        self.actions().capture(then);
    }

    /// For drawing on demand: false while another frame would show the same picture. True for events that wait, a
    /// manipulator that moves, tiles that are still to come, answers to occlusion queries and pictures that cameras of the
    /// graph read back, image sequences that play,
    /// update callbacks, what lies over the picture, and [`View::request_redraw`]. Tiles that find no room in the budgets
    /// or wait while the pager is paused ask for no frame. What failed does once its wait is over: a loop that rests looks
    /// again now and then.
    pub fn check_need_to_do_frame(&self) -> bool {
        needs_frame(&self.base, &self.view, std::slice::from_ref(&self.paged))
    }

    /// Paints an overlay over the next frame, in the context that the viewer was made with.
    #[cfg(feature = "window")]
    pub fn set_overlay(&mut self, paint: super::overlay::OverlayPaint) {
        self.base.set_overlay(self.context.0, paint);
    }

    /// The next frame's picture is read back; see [`Self::take_pictures`].
    pub fn want_picture(&mut self) {
        self.base.want_picture(self.context);
    }

    /// As [`Self::want_picture`], of any context.
    pub fn want_picture_of(&mut self, context: ContextId) {
        self.base.want_picture(context);
    }

    /// Pictures read back so far with their frame numbers, in order.
    pub fn take_pictures(&mut self) -> Vec<(u32, RgbaImage)> {
        self.base.take_pictures(self.context)
    }

    /// As [`Self::take_pictures`], of any context.
    pub fn take_pictures_of(&mut self, context: ContextId) -> Vec<(u32, RgbaImage)> {
        self.base.take_pictures(context)
    }

    /// Renders one frame; the simulation time is the wall's.
    pub fn frame(&mut self) -> Result<(), ViewerError> {
        self.frame_at(self.base.seconds())
    }

    /// Renders one frame at a simulation time.
    pub fn frame_at(&mut self, simulation_time_s: f64) -> Result<(), ViewerError> {
        self.base.compile_budget = self.compile_budget;
        let changes = changes(&self.base, &self.view, std::slice::from_ref(&self.paged));
        let mut frame = self.base.begin_frame(simulation_time_s, changes)?;
        let start = frame.start;
        let mut actions = self.actions();
        actions.event_traversal();
        #[cfg(feature = "window")]
        actions.lay_out_overlay();
        frame.end_events();
        self.paged.update(&self.base.stamp);
        // After the callbacks: what the camera follows may have moved.
        self.actions().update_camera(frame.dt_s);
        let (views, scenes) = (std::slice::from_mut(&mut self.view), std::slice::from_mut(&mut self.paged));
        self.base.end_frame(frame, views, scenes)?;
        self.note_convergence(start);
        Ok(())
    }

    fn note_convergence(&mut self, now: Instant) {
        let is_settled = self.base.pager_of(&self.paged).is_settled(std::slice::from_ref(&self.paged));
        let pose = self.view.camera.world_from_eye;
        let first_pose = *self.first_pose.get_or_insert(pose);
        if self.converge_s.is_none() && first_pose == pose && is_settled {
            self.converge_s = self.base.first_frame.map(|first| now.max(first).duration_since(first).as_secs_f64());
        }
    }

    /// For a loop with a frame rate of its own, instead of sleeping until the next frame is due: uploads, merges and
    /// expires what arrives, so that frames have less to do. Returns at `deadline`.
    pub fn work_until(&mut self, deadline: Instant) {
        self.base.work_until(std::slice::from_mut(&mut self.paged), deadline);
    }

    /// Waits until every frame has been drawn, so that statistics and pictures are complete. One that was lost with its
    /// device is no error here: the next [`Self::frame`] replaces the device, or says that it cannot.
    pub fn finish(&mut self) -> Result<(), ViewerError> {
        self.base.absorb_all()
    }

    /// The last frame's picture, offscreen. [`GpuError::DeviceLost`](crate::gpu::GpuError::DeviceLost) while the device
    /// is lost: the next [`Self::frame`]s replace it, upload everything again, and draw.
    pub fn read_back(&mut self) -> Result<RgbaImage, ViewerError> {
        self.base.read_back(self.context)
    }

    /// The last frame's picture in any context, offscreen; see [`Self::read_back`].
    pub fn read_back_of(&mut self, context: ContextId) -> Result<RgbaImage, ViewerError> {
        self.base.read_back(context)
    }
}
