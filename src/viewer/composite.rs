//! [`CompositeViewer`]: several views, each of a scene of its own or of one that they share. Main thread.

use std::path::Path;
use std::time::Instant;

use glam::DVec2;
use image::RgbaImage;

use super::ViewerError;
use super::base::ViewerBase;
use super::home::{LoadedRoot, SetBounds};
use super::input::{GuiActionAdapter, WindowMatrix, camera_with_focus, changes, needs_frame};
use super::paged_scene::PagedScene;
use super::rendering::ThreadingModel;
use super::scene_pager::{MOST_SCENES, free_owner};
use super::stats::StatsHistory;
use super::view::{ContextId, Slave, SlaveId, View};
use super::viewer::{FrameStamp, UpdateCallback, ViewerConfig};
use super::viewport::Viewport;
use crate::gpu::{ContextTraits, GraphicsContext};
use crate::pager::{DatabasePager, ImagePager, ImageSequence};
use crate::scene::{Page, PageId, Scene};

/// A scene of a [`CompositeViewer`]; never the same again once it was removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SceneId(u32);

/// A view of a [`CompositeViewer`]; never the same again once it was removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ViewId(u32);

/// Views, their scenes and their contexts: one frame for all of them.
pub struct CompositeViewer {
    config: ViewerConfig,
    base: ViewerBase,
    scenes: Vec<PagedScene>,
    /// By place in `scenes`.
    scene_ids: Vec<SceneId>,
    next_scene: u32,
    views: Vec<View>,
    /// By place in `views`.
    view_ids: Vec<ViewId>,
    next_view: u32,
}

impl CompositeViewer {
    /// A viewer without contexts, scenes and views.
    pub fn new(config: &ViewerConfig) -> Result<Self, ViewerError> {
        let base = ViewerBase::new(config)?;
        Ok(Self {
            config: config.clone(),
            base,
            scenes: Vec::new(),
            scene_ids: Vec::new(),
            next_scene: 0,
            views: Vec::new(),
            view_ids: Vec::new(),
            next_view: 0,
        })
    }

    /// Takes a context to draw views in; at most [`ViewerConfig::max_contexts`]. What scenes have is uploaded to it.
    pub fn open_context(&mut self, context: GraphicsContext) -> Result<ContextId, ViewerError> {
        self.base.open_context(context, &mut self.scenes)
    }

    /// Opens an offscreen context on the device of another one; see [`Viewer::open_offscreen_on`](super::Viewer::open_offscreen_on).
    pub fn open_offscreen_on(&mut self, other: ContextId, traits: &ContextTraits) -> Result<ContextId, ViewerError> {
        self.base.open_context_on(other, traits, GraphicsContext::add_offscreen)
    }

    /// As [`Self::open_offscreen_on`], a window; called on the thread of the event loop.
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
        self.base.close_context(id, &mut self.views, &mut self.scenes)
    }

    /// The open contexts, in the order opened.
    pub fn contexts(&self) -> impl Iterator<Item = ContextId> {
        self.base.rendering.context_ids().map(ContextId)
    }

    /// An empty scene with a pager and budgets of its own.
    pub fn add_scene(&mut self) -> Result<SceneId, ViewerError> {
        self.push_scene(None)
    }

    /// An empty scene with the pager of another one (OSG: `osgViewer::Scene::setDatabasePager` with another scene's): one
    /// list of requests, one set of threads and one budget for both, and what is equal in both is there once. What each
    /// of them may read, and as whom it asks servers, stays its own.
    pub fn add_scene_with_pager_of(&mut self, other: SceneId) -> Result<SceneId, ViewerError> {
        let pager = self.paged(other)?.pager;
        self.push_scene(Some(pager))
    }

    fn push_scene(&mut self, shared: Option<usize>) -> Result<SceneId, ViewerError> {
        let place = self.scenes.len();
        let owner = free_owner(self.scenes.iter().map(PagedScene::owner));
        let owner = owner.ok_or(ViewerError::TooManyScenes { limit: MOST_SCENES })?;
        let pager = self.base.add_pager(place, shared);
        self.scenes.push(PagedScene::new(owner, pager, self.config.pager.clone(), self.config.keep_drawables));
        let id = SceneId(self.next_scene);
        self.next_scene += 1;
        self.scene_ids.push(id);
        Ok(id)
    }

    /// Takes a scene out, with all that it has on devices, its image pager, and its pager with the threads of both; a pager
    /// that others share goes on with their pages alone. As in OSG a view keeps its scene: while some show it, that is
    /// [`ViewerError::SceneInUse`], and nothing happens. Blocks until all frames are drawn and all uploads under way are
    /// done; memory of adapters is free when the frames that may still read it are over.
    pub fn remove_scene(&mut self, id: SceneId) -> Result<(), ViewerError> {
        let place = self.scene_place(id)?;
        let views = self.views.iter().filter(|view| view.scene == place).count();
        if views > 0 {
            return Err(ViewerError::SceneInUse { scene: id, views });
        }
        self.base.absorb_all()?;
        self.base.remove_scene(&mut self.scenes, place);
        self.scene_ids.remove(place);
        for view in self.views.iter_mut().filter(|view| view.scene > place) {
            view.scene -= 1;
        }
        Ok(())
    }

    /// The scenes, in the order added.
    pub fn scenes(&self) -> impl Iterator<Item = SceneId> {
        self.scene_ids.iter().copied()
    }

    fn scene_place(&self, id: SceneId) -> Result<usize, ViewerError> {
        self.scene_ids.iter().position(|of| *of == id).ok_or(ViewerError::NoScene(id))
    }

    fn paged(&self, id: SceneId) -> Result<&PagedScene, ViewerError> {
        Ok(&self.scenes[self.scene_place(id)?])
    }

    fn paged_mut(&mut self, id: SceneId) -> Result<&mut PagedScene, ViewerError> {
        let place = self.scene_place(id)?;
        Ok(&mut self.scenes[place])
    }

    /// Loads a root tile set into a scene that shows none, and places the cameras of its views at the first view of it.
    pub fn load(&mut self, scene: SceneId, source: &str) -> Result<PageId, ViewerError> {
        self.set_root(scene, LoadedRoot::read(source, &self.config.pager)?)
    }

    /// As [`Self::load`], with a root that was read before there was a viewer.
    pub fn set_root(&mut self, scene: SceneId, root: LoadedRoot) -> Result<PageId, ViewerError> {
        let place = self.scene_place(scene)?;
        let root = self.base.set_root(&mut self.scenes, place, root)?;
        self.first_sight(place);
        Ok(root)
    }

    /// Adds a page made by the application as a root of a scene. The first root places the cameras of its views.
    pub fn add_root(&mut self, scene: SceneId, page: Page) -> Result<PageId, ViewerError> {
        let place = self.scene_place(scene)?;
        let paged = &mut self.scenes[place];
        let is_first = paged.bounds.is_none();
        let root = paged.add_root(page, &mut self.base.rendering)?;
        if is_first {
            self.first_sight(place);
        }
        Ok(root)
    }

    fn first_sight(&mut self, place: usize) {
        self.for_each_view(|mut view| {
            if view.view.scene == place {
                view.first_sight();
            }
        });
    }

    /// Takes a root out of a scene; `None` when it is not a root, or while pages hang in it. What comes back is as
    /// [`Viewer::remove_root`](super::Viewer::remove_root) has it.
    pub fn remove_root(&mut self, scene: SceneId, id: PageId) -> Result<Option<Page>, ViewerError> {
        let place = self.scene_place(scene)?;
        Ok(self.scenes[place].remove_root(id, &mut self.base.rendering))
    }

    /// Pages files in a folder and below, for a scene made by hand.
    pub fn page_files_in(&mut self, scene: SceneId, folder: &Path) -> Result<(), ViewerError> {
        let place = self.scene_place(scene)?;
        let pager = self.scenes[place].pager_of_files(folder)?;
        self.base.set_pager(&mut self.scenes, place, pager)
    }

    /// A scene; pages may be added and transforms set between frames.
    pub fn scene_mut(&mut self, scene: SceneId) -> Result<&mut Scene, ViewerError> {
        Ok(self.paged_mut(scene)?.scene_mut())
    }

    /// A scene.
    pub fn scene(&self, scene: SceneId) -> Result<&Scene, ViewerError> {
        Ok(self.paged(scene)?.scene())
    }

    /// The pager that serves a scene, once a set is loaded into it or into one that shares its pager.
    pub fn pager(&self, scene: SceneId) -> Result<Option<&DatabasePager>, ViewerError> {
        Ok(self.base.pager_of(self.paged(scene)?).pager())
    }

    /// The pager that serves a scene, to pause it or to have it take no new requests; for all scenes that share it.
    pub fn pager_mut(&mut self, scene: SceneId) -> Result<Option<&mut DatabasePager>, ViewerError> {
        let of = self.paged(scene)?.pager;
        Ok(self.base.pagers[of].pager_mut())
    }

    /// True when one pager serves both scenes.
    pub fn shares_pager(&self, scene: SceneId, other: SceneId) -> Result<bool, ViewerError> {
        Ok(self.paged(scene)?.pager == self.paged(other)?.pager)
    }

    /// Takes every page that the pager of a scene merged out of it and forgets what was asked for; what is wanted is
    /// loaded anew from the next frame on. Scenes that share its pager keep theirs.
    pub fn clear_pages(&mut self, scene: SceneId) -> Result<(), ViewerError> {
        let place = self.scene_place(scene)?;
        self.base.clear_pages(&mut self.scenes, place);
        Ok(())
    }

    /// What could not be drawn as it should so far, each once: what the device complained of, too.
    pub fn draw_errors(&self) -> &[String] {
        &self.base.draw_errors
    }

    /// Lets a sequence's texture show its images in a scene; see [`ImageSequence`].
    pub fn add_image_sequence(&mut self, scene: SceneId, sequence: &ImageSequence) -> Result<(), ViewerError> {
        self.paged_mut(scene)?.add_image_sequence(sequence)
    }

    /// The image pager of a scene, once a sequence was added.
    pub fn image_pager(&self, scene: SceneId) -> Result<Option<&ImagePager>, ViewerError> {
        Ok(self.paged(scene)?.image_pager.as_ref())
    }

    /// True when the tiles of a scene's tile set are height tiles, or where none was loaded those of its first root.
    pub fn is_height_set(&self, scene: SceneId) -> Result<bool, ViewerError> {
        Ok(self.paged(scene)?.is_height_set())
    }

    /// Extent of the tile set that was loaded into a scene; without one, of its first root.
    pub fn bounds(&self, scene: SceneId) -> Result<Option<&SetBounds>, ViewerError> {
        Ok(self.paged(scene)?.bounds.as_ref())
    }

    /// Adds something to do to a scene in each update phase.
    pub fn on_update(&mut self, scene: SceneId, callback: UpdateCallback) -> Result<(), ViewerError> {
        self.paged_mut(scene)?.update_callbacks.push(callback);
        Ok(())
    }

    /// True when the last frame showed everything its views wanted and no pager has anything to do.
    pub fn is_settled(&self) -> bool {
        self.base.pagers.iter().all(|pager| pager.is_at_rest(&self.scenes))
    }

    /// Adds a view of a scene, drawn in a part of a context after those that are there.
    pub fn add_view(
        &mut self,
        scene: SceneId,
        context: ContextId,
        viewport: impl Into<Viewport>,
    ) -> Result<ViewId, ViewerError> {
        let of = self.scene_place(scene)?;
        let bounds = self.scenes[of].bounds;
        let place = self.base.add_camera(context, viewport.into())?;
        let ViewerConfig { size_px, samples, .. } = self.config;
        let mut view = View::new(of, self.config.cull_settings(), size_px, samples);
        view.master = Some(place);
        view.set_stereo(self.config.stereo);
        view.prepare(&self.base.rendering, bounds.as_ref());
        if let Some(bounds) = &bounds {
            view.first_sight(bounds);
        }
        let id = ViewId(self.next_view);
        self.next_view += 1;
        self.views.push(view);
        self.view_ids.push(id);
        Ok(id)
    }

    /// The scene of a view.
    pub fn scene_of(&self, view: ViewId) -> Result<SceneId, ViewerError> {
        Ok(self.scene_ids[self.views[self.place_of(view)?].scene])
    }

    fn place_of(&self, id: ViewId) -> Result<usize, ViewerError> {
        self.view_ids.iter().position(|of| *of == id).ok_or(ViewerError::NoView(id))
    }

    /// Takes a view with all its cameras out; its scene stays.
    pub fn remove_view(&mut self, id: ViewId) -> Result<(), ViewerError> {
        let place = self.place_of(id)?;
        self.base.absorb_all()?;
        for camera in self.views[place].cameras() {
            self.base.rendering.remove_camera(camera);
        }
        let gone = self.views.remove(place);
        self.view_ids.remove(place);
        // What it covered is seen, or nothing any more.
        for context in gone.contexts() {
            self.views.iter_mut().for_each(|view| view.redraw_in(context));
        }
        Ok(())
    }

    /// The views, in the order added.
    pub fn views(&self) -> impl Iterator<Item = (ViewId, &View)> {
        self.view_ids.iter().copied().zip(&self.views)
    }

    /// A view, to move its camera.
    pub fn view_mut(&mut self, id: ViewId) -> Result<&mut View, ViewerError> {
        let place = self.place_of(id)?;
        Ok(&mut self.views[place])
    }

    /// What the handlers of a view are given: its queue, handlers and manipulator are set by it.
    pub fn actions(&mut self, view: ViewId) -> Result<GuiActionAdapter<'_>, ViewerError> {
        let place = self.place_of(view)?;
        let view = &mut self.views[place];
        let paged = &mut self.scenes[view.scene];
        Ok(GuiActionAdapter { base: &mut self.base, view, paged })
    }

    /// The view that has the focus at a place of a context, pixels from its upper left corner: of those there, the one
    /// drawn last; with the place in the view's own picture, which is what goes into its event queue.
    pub fn view_at(&self, context: ContextId, position_px: DVec2) -> Option<(ViewId, DVec2)> {
        let here = self.views().filter(|(_, view)| view.context() == Some(context));
        let (ids, cameras): (Vec<ViewId>, Vec<WindowMatrix>) =
            here.map(|(id, view)| (id, view.window_matrix())).unzip();
        let place = camera_with_focus(&cameras, position_px)?;
        Some((*ids.get(place)?, position_px - cameras.get(place)?.origin_px))
    }

    /// True once the user of a view or the application wants an end.
    pub fn is_done(&self) -> bool {
        self.views.iter().any(View::is_done)
    }

    /// For drawing on demand: false while another frame would show the same pictures; see
    /// [`Viewer::check_need_to_do_frame`](super::Viewer::check_need_to_do_frame).
    pub fn check_need_to_do_frame(&self) -> bool {
        self.views.iter().any(|view| needs_frame(&self.base, view, &self.scenes))
    }

    /// Adds a camera that goes with the master camera of a view.
    pub fn add_slave(&mut self, view: ViewId, slave: Slave) -> Result<SlaveId, ViewerError> {
        let place = self.place_of(view)?;
        self.base.add_slave(&mut self.views[place], slave)
    }

    /// Takes a slave out; false when there is none.
    pub fn remove_slave(&mut self, view: ViewId, id: SlaveId) -> Result<bool, ViewerError> {
        let place = self.place_of(view)?;
        self.base.remove_slave(&mut self.views[place], id)
    }

    /// Renders one frame of all views; the simulation time is the wall's.
    pub fn frame(&mut self) -> Result<(), ViewerError> {
        self.frame_at(self.base.seconds())
    }

    /// Renders one frame of all views at a simulation time.
    pub fn frame_at(&mut self, simulation_time_s: f64) -> Result<(), ViewerError> {
        let changes = self.views.iter().any(|view| changes(&self.base, view, &self.scenes));
        let mut frame = self.base.begin_frame(simulation_time_s, changes)?;
        self.for_each_view(|mut view| view.event_traversal());
        #[cfg(feature = "window")]
        self.for_each_view(|mut view| view.lay_out_overlay());
        frame.end_events();
        for scene in &mut self.scenes {
            scene.update(&self.base.stamp);
        }
        // After the callbacks: what cameras follow may have moved.
        self.for_each_view(|mut view| view.update_camera(frame.dt_s));
        self.base.end_frame(frame, &mut self.views, &mut self.scenes)
    }

    fn for_each_view(&mut self, act: impl Fn(GuiActionAdapter<'_>)) {
        for view in &mut self.views {
            let paged = &mut self.scenes[view.scene];
            act(GuiActionAdapter { base: &mut self.base, view, paged });
        }
    }

    /// Uploads, merges and expires what arrives, instead of sleeping until the next frame is due. Returns at
    /// `deadline`.
    pub fn work_until(&mut self, deadline: Instant) {
        self.base.work_until(&mut self.scenes, deadline);
    }

    /// Waits until every frame has been drawn, so that statistics and pictures are complete. One that was lost with its
    /// device is no error here: the next [`Self::frame`] replaces the device, or says that it cannot.
    pub fn finish(&mut self) -> Result<(), ViewerError> {
        self.base.absorb_all()
    }

    /// The new size of a context in pixels.
    pub fn resize_context(&mut self, context: ContextId, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.base.resize(context, size_px)?;
        self.views.iter_mut().for_each(|view| view.redraw_in(context));
        Ok(())
    }

    /// The next frame's picture in a context is read back; see [`Self::take_pictures`].
    pub fn want_picture(&mut self, context: ContextId) {
        self.base.want_picture(context);
    }

    /// Pictures of a context that were read back, with their frame numbers, in order.
    pub fn take_pictures(&mut self, context: ContextId) -> Vec<(u32, RgbaImage)> {
        self.base.take_pictures(context)
    }

    /// The last frame's picture in a context, offscreen.
    pub fn read_back(&mut self, context: ContextId) -> Result<RgbaImage, ViewerError> {
        self.base.read_back(context)
    }

    /// Number and times of the last frame.
    pub fn frame_stamp(&self) -> FrameStamp {
        self.base.stamp
    }

    /// Statistics of the frames so far, all views together.
    pub fn stats(&self) -> &StatsHistory {
        &self.base.history
    }

    /// The threading model that runs, or will from the first frame on.
    pub fn threading_model(&self) -> ThreadingModel {
        self.base.rendering.model()
    }

    /// Changes the threading model at run time, after all frames are drawn.
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
}
