//! [`CompositeViewer`]: several views of separate or shared scenes, and the contexts that they are drawn in.
//! [`Viewer`](super::Viewer) is a composite viewer with a single view. Main thread.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use glam::DVec2;
use image::RgbaImage;

use super::ViewerError;
use super::clock::FrameStamp;
use super::frame::{EnvironmentChanges, FrameLoop, StatsHistory, ViewerConfig};
use super::ids::{ContextId, KeyedList, PagerId, SceneId, SlaveId, ViewId};
use super::input::{GuiActionAdapter, changes, needs_frame};
use super::paging::{LoadedRoot, MAX_SCENES, PagedScene, SceneList, SceneUpdate, free_owner};
use super::rendering::ThreadingModel;
use super::view::set_bounds::SetBounds;
use super::view::viewport::ViewArea;
use super::view::{Slave, View, ViewList};
use crate::formats::OverlaySet;
use crate::gpu::CompileBudget;
use crate::pager::{DatabasePager, ImagePager, ImageSequence};
use crate::scene::{Page, PageId, Scene};
use crate::sync::OperationQueue;

/// Views, their scenes and their contexts, with one frame for all of them; osgViewer's `CompositeViewer`.
///
/// One thread owns it and calls [`Self::frame`]: that of the event loop if it has windows.
///
/// A context is one target, a window or an offscreen texture, on a device. Contexts may have a device each
/// ([`Self::open_window`], [`Self::open_context`]) or share one ([`Self::open_window_on`], [`Self::open_offscreen_on`]).
///
/// ```text
/// frame()   advance    frame stamp
///           event      for each view: queue -> handlers -> manipulator -> event callbacks of nodes
///           update     &mut Scene: callbacks, cameras from manipulators, pagers (expire, merge, request)
///           rendering  cull: &Scene -> render stage; draw: the stage moves to the thread of the context;
///                      the ThreadingModel decides which threads run them
/// ```
pub struct CompositeViewer {
    pub(super) frame: FrameLoop,
    pub(super) scenes: SceneList,
    pub(super) views: ViewList,
    /// The view of a [`Viewer`](super::Viewer), which cannot be removed.
    own_view: Option<ViewId>,
    /// The application's operations in update. Any thread adds to them.
    pub(super) update_operations: Arc<OperationQueue<Self>>,
}

impl CompositeViewer {
    /// Creates a viewer without contexts, scenes and views.
    pub fn new(config: &ViewerConfig) -> Result<Self, ViewerError> {
        let frame = FrameLoop::new(config)?;
        let (scenes, views) = (KeyedList::new(), KeyedList::new());
        Ok(Self { frame, scenes, views, own_view: None, update_operations: Arc::default() })
    }
}

/// Scenes and what they contain.
impl CompositeViewer {
    /// Adds an empty scene with its own pager and budgets.
    pub fn add_scene(&mut self) -> Result<SceneId, ViewerError> {
        self.push_scene(None)
    }

    /// Adds an empty scene that shares the pager of another one (OSG: `osgViewer::Scene::setDatabasePager` with another
    /// scene's pager). Both have one list of requests, one set of threads and one budget; contents that are equal in both
    /// are loaded once. The files that each may read, and its credentials for servers, stay separate.
    pub fn add_scene_with_pager_of(&mut self, other: SceneId) -> Result<SceneId, ViewerError> {
        let pager = self.paged(other)?.pager();
        self.push_scene(Some(pager))
    }

    fn push_scene(&mut self, shared: Option<PagerId>) -> Result<SceneId, ViewerError> {
        let owner = free_owner(self.scenes.values().map(PagedScene::owner));
        let owner = owner.ok_or(ViewerError::TooManyScenes { limit: MAX_SCENES })?;
        let pager = self.frame.pagers.assign(self.scenes.next_key(), shared);
        let config = self.frame.config();
        Ok(self.scenes.push(PagedScene::new(owner, pager, config.pager.clone(), config.keep_drawables)))
    }

    /// Removes a scene with everything that it has on devices, its image pager, and its pager unless other scenes share it.
    /// Fails with [`ViewerError::SceneInUse`] while a view shows the scene. Blocks until all frames are drawn and all
    /// uploads in flight are done; GPU memory is free after the frames that may still read it.
    pub fn remove_scene(&mut self, id: SceneId) -> Result<(), ViewerError> {
        self.check_scene(id)?;
        let views = self.views.values().filter(|view| view.scene() == id).count();
        if views > 0 {
            return Err(ViewerError::SceneInUse { scene: id, views });
        }
        self.frame.finish()?;
        self.frame.pagers.remove_scene(&mut self.scenes, id, &mut self.frame.rendering);
        if self.views.values().next().is_none() {
            // No frame will be drawn that could free a part.
            self.flush_deleted_objects();
        }
        Ok(())
    }

    /// Returns the scenes, in the order added.
    pub fn scenes(&self) -> impl Iterator<Item = SceneId> {
        self.scenes.iter().map(|(id, _)| id)
    }

    fn check_scene(&self, id: SceneId) -> Result<(), ViewerError> {
        if self.scenes.contains(id) { Ok(()) } else { Err(ViewerError::NoScene(id)) }
    }

    fn paged(&self, id: SceneId) -> Result<&PagedScene, ViewerError> {
        self.scenes.get(id).ok_or(ViewerError::NoScene(id))
    }

    fn paged_mut(&mut self, id: SceneId) -> Result<&mut PagedScene, ViewerError> {
        self.scenes.get_mut(id).ok_or(ViewerError::NoScene(id))
    }

    /// Loads a root tile set (folder, file or URL) into a scene without one, and moves the cameras of its views to the
    /// first view of it. Blocks until the root is read.
    pub fn load(&mut self, scene: SceneId, source: &str) -> Result<PageId, ViewerError> {
        let root = self.paged(scene)?.read_root(source, &self.frame.rendering)?;
        self.set_root(scene, root)
    }

    /// Does the same as [`Self::load`] with a root that was read earlier.
    pub fn set_root(&mut self, scene: SceneId, root: LoadedRoot) -> Result<PageId, ViewerError> {
        self.check_scene(scene)?;
        let root = self.frame.pagers.set_root(&mut self.scenes, scene, root, &mut self.frame.rendering)?;
        self.first_sight(scene);
        Ok(root)
    }

    /// Adds a page of the application as a root of a scene. Paged contents in it are read by the pager of
    /// [`Self::page_files_in`] or [`Self::set_pager`]. The first root positions the cameras of the scene's views.
    pub fn add_root(&mut self, scene: SceneId, page: Page) -> Result<PageId, ViewerError> {
        let paged = self.scenes.get_mut(scene).ok_or(ViewerError::NoScene(scene))?;
        let is_first = paged.bounds().is_none();
        let root = paged.add_root(page, &mut self.frame.rendering)?;
        if is_first {
            self.first_sight(scene);
        }
        Ok(root)
    }

    /// Moves the cameras of a scene's views to the first view of it.
    fn first_sight(&mut self, scene: SceneId) {
        self.for_each_view(|mut view| {
            if view.view.scene() == scene {
                view.first_sight();
            }
        });
    }

    /// Removes a root from a scene and frees its GPU memory; `None` when it is not a root, or while pages are attached to
    /// it. Added again, the page is drawn as before; without [`ViewerConfig::keep_drawables`] it is returned without its
    /// drawables and draws nothing.
    pub fn remove_root(&mut self, scene: SceneId, id: PageId) -> Result<Option<Page>, ViewerError> {
        let paged = self.scenes.get_mut(scene).ok_or(ViewerError::NoScene(scene))?;
        Ok(paged.remove_root(id, &mut self.frame.rendering))
    }

    /// Gives a scene built by the application a pager that may read the files in a folder and below.
    pub fn page_files_in(&mut self, scene: SceneId, folder: &Path) -> Result<(), ViewerError> {
        let pager = self.paged(scene)?.new_folder_pager(folder)?;
        self.set_pager(scene, pager)
    }

    /// Replaces the pager of a scene and removes the pages that the old one merged. A pager that other scenes share is
    /// kept, and takes over the scope of the new one for this scene.
    pub fn set_pager(&mut self, scene: SceneId, pager: DatabasePager) -> Result<(), ViewerError> {
        self.check_scene(scene)?;
        self.frame.pagers.set_pager(&mut self.scenes, scene, pager, &mut self.frame.rendering)
    }

    /// Returns a scene for changes. Pages may be added and transforms set between frames.
    pub fn scene_mut(&mut self, scene: SceneId) -> Result<&mut Scene, ViewerError> {
        Ok(self.paged_mut(scene)?.scene_mut())
    }

    /// Returns a scene.
    pub fn scene(&self, scene: SceneId) -> Result<&Scene, ViewerError> {
        Ok(self.paged(scene)?.scene())
    }

    /// Returns the pager of a scene; `None` until a set was loaded into it, or into a scene that shares its pager.
    pub fn pager(&self, scene: SceneId) -> Result<Option<&DatabasePager>, ViewerError> {
        Ok(self.frame.pager_of(self.paged(scene)?).pager())
    }

    /// Returns the pager of a scene, to pause it or to stop new requests. That affects all scenes that share it.
    pub fn pager_mut(&mut self, scene: SceneId) -> Result<Option<&mut DatabasePager>, ViewerError> {
        let paged = self.scenes.get(scene).ok_or(ViewerError::NoScene(scene))?;
        Ok(self.frame.pagers.of_mut(paged).pager_mut())
    }

    /// Returns true when one pager serves both scenes.
    pub fn shares_pager(&self, scene: SceneId, other: SceneId) -> Result<bool, ViewerError> {
        Ok(self.paged(scene)?.pager() == self.paged(other)?.pager())
    }

    /// Removes every page that the pager merged into a scene, and forgets its requests; the next frames load what they need
    /// again. Scenes that share the pager keep their pages.
    pub fn clear_pages(&mut self, scene: SceneId) -> Result<(), ViewerError> {
        self.check_scene(scene)?;
        self.frame.pagers.clear_pages(&mut self.scenes, scene, &mut self.frame.rendering);
        Ok(())
    }

    /// Returns the overlays of a scene; at first those of [`PagerConfig::overlays`](crate::pager::PagerConfig::overlays).
    pub fn overlays(&self, scene: SceneId) -> Result<Option<&Arc<OverlaySet>>, ViewerError> {
        Ok(self.paged(scene)?.overlays())
    }

    /// Replaces the overlays of a scene: adds and removes them, changes their order or opacity. What is on screen stays until
    /// it is loaded again with the new ones, content by content. [`OverlaySet::with_overlays`] keeps decoded images.
    pub fn set_overlays(&mut self, scene: SceneId, overlays: Option<Arc<OverlaySet>>) -> Result<(), ViewerError> {
        self.check_scene(scene)?;
        self.frame.pagers.set_overlays(&mut self.scenes, scene, overlays, &mut self.frame.rendering);
        Ok(())
    }

    /// Shows the images of a sequence in its texture, over simulation time; see [`ImageSequence`].
    pub fn add_image_sequence(&mut self, scene: SceneId, sequence: &ImageSequence) -> Result<(), ViewerError> {
        self.paged_mut(scene)?.add_image_sequence(sequence)
    }

    /// Replaces the image pager of a scene; sequences of the old one must be added again.
    pub fn set_image_pager(&mut self, scene: SceneId, pager: ImagePager) -> Result<(), ViewerError> {
        self.paged_mut(scene)?.set_image_pager(pager);
        Ok(())
    }

    /// Returns the image pager of a scene; `None` until a sequence was added.
    pub fn image_pager(&self, scene: SceneId) -> Result<Option<&ImagePager>, ViewerError> {
        Ok(self.paged(scene)?.image_pager())
    }

    /// Returns the URI of a scene's root tile set; `None` without one or after it was removed.
    pub fn root_uri(&self, scene: SceneId) -> Result<Option<&str>, ViewerError> {
        Ok(self.paged(scene)?.root_uri())
    }

    /// Returns true when the tiles of a scene's tile set, or of its first root, are height tiles on a shared grid, whose
    /// error is in the height alone.
    pub fn is_height_set(&self, scene: SceneId) -> Result<bool, ViewerError> {
        Ok(self.paged(scene)?.is_height_set())
    }

    /// Returns the extent of a scene's tile set, or of its first root.
    pub fn bounds(&self, scene: SceneId) -> Result<Option<&SetBounds>, ViewerError> {
        Ok(self.paged(scene)?.bounds())
    }

    /// Adds a callback for each update phase of a scene.
    pub fn on_update(&mut self, scene: SceneId, callback: SceneUpdate) -> Result<(), ViewerError> {
        self.paged_mut(scene)?.on_update(callback);
        Ok(())
    }
}

/// Views and their cameras.
impl CompositeViewer {
    /// Adds a view of a scene in a part of a context, drawn after the cameras that the context has.
    pub fn add_view(
        &mut self,
        scene: SceneId,
        context: ContextId,
        viewport: impl Into<ViewArea>,
    ) -> Result<ViewId, ViewerError> {
        let bounds = self.paged(scene)?.bounds().copied();
        let slot = self.frame.add_camera(context, viewport.into())?;
        let config = self.frame.config();
        let clock = self.frame.timer().clock().clone();
        let mut view = View::new(scene, config.cull_settings(), config.size_px, config.samples, slot, clock);
        view.camera.field_of_view = config.field_of_view;
        view.set_stereo(config.stereo);
        view.prepare(&self.frame.rendering, bounds.as_ref());
        if let Some(bounds) = &bounds {
            view.first_sight(bounds);
        }
        Ok(self.views.push(view))
    }

    /// Adds the view of a [`Viewer`](super::Viewer), which cannot be removed.
    pub(super) fn add_own_view(&mut self, scene: SceneId, context: ContextId) -> Result<ViewId, ViewerError> {
        let view = self.add_view(scene, context, ViewArea::Whole)?;
        self.own_view = Some(view);
        Ok(view)
    }

    /// Returns the scene of a view.
    pub fn scene_of(&self, view: ViewId) -> Result<SceneId, ViewerError> {
        Ok(self.view(view)?.scene())
    }

    /// Removes a view with all its cameras; its scene stays.
    pub fn remove_view(&mut self, id: ViewId) -> Result<(), ViewerError> {
        if self.own_view == Some(id) {
            return Err(ViewerError::OwnView(id));
        }
        let view = self.views.get(id).ok_or(ViewerError::NoView(id))?;
        self.frame.remove_cameras_of(view)?;
        self.frame.look_aheads.forget(id);
        let Some(removed) = self.views.remove(id) else { return Ok(()) };
        // The area that it covered must be drawn again.
        for context in removed.contexts() {
            self.views.values_mut().for_each(|view| view.redraw_in(context));
        }
        Ok(())
    }

    /// Returns the views, in the order added.
    pub fn views(&self) -> impl Iterator<Item = (ViewId, &View)> {
        self.views.iter()
    }

    /// Returns a view.
    pub fn view(&self, id: ViewId) -> Result<&View, ViewerError> {
        self.views.get(id).ok_or(ViewerError::NoView(id))
    }

    /// Returns a view, for example to move its camera.
    pub fn view_mut(&mut self, id: ViewId) -> Result<&mut View, ViewerError> {
        self.views.get_mut(id).ok_or(ViewerError::NoView(id))
    }

    /// Returns a view together with its scene and the viewer, as its event handlers get them.
    pub fn actions(&mut self, view: ViewId) -> Result<GuiActionAdapter<'_>, ViewerError> {
        let view = self.views.get_mut(view).ok_or(ViewerError::NoView(view))?;
        let paged = &mut self.scenes[view.scene()];
        Ok(GuiActionAdapter { base: &mut self.frame, view, paged })
    }

    /// Returns the view at a position of a context, in pixels from its upper left corner, and the position in the image of the
    /// view's master camera ([`View::in_master`]). Of overlapping views it is the one drawn last. Events of the pointer go
    /// to its event queue.
    pub fn view_at(&self, context: ContextId, position_px: DVec2) -> Option<(ViewId, DVec2)> {
        let at = |(id, view)| View::camera_at(view, context, position_px).map(|(camera, source)| (camera, id, source));
        let (_, id, source) = self.views().filter_map(at).max_by_key(|(camera, ..)| *camera)?;
        Some((id, self.views.get(id)?.in_master(source, position_px)))
    }

    /// Adds a camera that follows the master camera of a view. It may be drawn in any context, for example another window.
    pub fn add_slave(&mut self, view: ViewId, slave: Slave) -> Result<SlaveId, ViewerError> {
        let view = self.views.get_mut(view).ok_or(ViewerError::NoView(view))?;
        self.frame.add_slave(view, slave)
    }

    /// Removes a slave; returns false when the view has no such slave.
    pub fn remove_slave(&mut self, view: ViewId, id: SlaveId) -> Result<bool, ViewerError> {
        let view = self.views.get_mut(view).ok_or(ViewerError::NoView(view))?;
        self.frame.remove_slave(view, id)
    }

    /// Paints an overlay over the next frame of a context.
    #[cfg(feature = "window")]
    pub fn set_overlay(&mut self, context: ContextId, paint: super::overlay::OverlayPaint) {
        self.frame.set_overlay(context.0, paint);
    }
}

/// Frames, the threads that run them, and their results.
impl CompositeViewer {
    /// Renders one frame of all views; simulation time follows the wall clock. In models that overlap frames it returns before the
    /// images are drawn.
    ///
    /// # Errors
    /// Fails if a context cannot be drawn, if a thread that draws or culls has ended, or with the error of a callback. A lost device
    /// is replaced instead, and is an error only if it is lost again soon. Tiles that fail to load are no errors of a frame.
    pub fn frame(&mut self) -> Result<(), ViewerError> {
        self.frame_at(self.frame.timer().seconds())
    }

    /// Renders one frame of all views at a simulation time in seconds, as [`Self::frame`] does.
    pub fn frame_at(&mut self, simulation_time_s: f64) -> Result<(), ViewerError> {
        let has_changes =
            self.has_operations() || self.views.values().any(|view| changes(&self.frame, view, &self.scenes));
        let mut frame = self.frame.begin_frame(simulation_time_s, has_changes);
        self.for_each_view(|mut view| view.event_traversal());
        #[cfg(feature = "window")]
        self.for_each_view(|mut view| view.lay_out_overlay());
        frame.end_events();
        let stamp = self.frame.stamp();
        self.scenes.values_mut().for_each(|scene| scene.update(&stamp));
        self.run_update_operations();
        // Cameras move after the update callbacks, because manipulators may follow what these moved.
        self.for_each_view(|mut view| view.update_camera(frame.dt_s));
        self.frame.end_frame(frame, &mut self.views, &mut self.scenes)
    }

    fn for_each_view(&mut self, act: impl Fn(GuiActionAdapter<'_>)) {
        for view in self.views.values_mut() {
            let paged = &mut self.scenes[view.scene()];
            act(GuiActionAdapter { base: &mut self.frame, view, paged });
        }
    }

    /// Returns false while another frame would show the same images, for applications that draw on demand. Returns true for
    /// waiting events, moving manipulators, tiles in flight, missing results of occlusion queries and read-backs, playing
    /// image sequences, update callbacks, overlays, and [`View::request_redraw`]. Tiles that find no memory, or wait for a
    /// paused pager, ask for no frame. A failed request asks for one after its back-off, so an idle loop should call this
    /// now and then.
    pub fn check_need_to_do_frame(&self) -> bool {
        self.has_operations() || self.views.values().any(|view| needs_frame(&self.frame, view, &self.scenes))
    }

    /// Returns true once the user of a view or the application has asked to end.
    pub fn is_done(&self) -> bool {
        self.views.values().any(View::is_done)
    }

    /// Returns true when the last frame showed everything that its views wanted, no transition between levels of detail is
    /// under way, no change of an environment waits for its pipelines, and every pager is idle.
    pub fn is_settled(&self) -> bool {
        let is_changing = self.views.values().any(|view| view.shown.is_changing());
        !is_changing && self.frame.pagers.iter().all(|group| group.is_at_rest(&self.scenes))
    }

    /// Merges and uploads arrived pages until `deadline`, instead of sleeping until the next frame is due, so that frames
    /// have less to do. For loops with a frame rate.
    pub fn work_until(&mut self, deadline: Instant) {
        self.frame.work_until(&self.views, &mut self.scenes, deadline);
    }

    /// Waits until all frames are drawn, so that statistics and images are complete. A frame that was lost with its device
    /// is no error here: the next [`Self::frame`] replaces the device, or reports that it cannot.
    pub fn finish(&mut self) -> Result<(), ViewerError> {
        self.frame.finish()
    }

    /// Has the next frame of a context read back; see [`Self::take_pictures`].
    pub fn want_picture(&mut self, context: ContextId) {
        self.frame.pictures_mut().want(context.0);
    }

    /// Returns the images of a context that have arrived, with their frame numbers, in order.
    pub fn take_pictures(&mut self, context: ContextId) -> Vec<(u32, RgbaImage)> {
        self.frame.pictures_mut().take(context.0)
    }

    /// Waits until all frames are drawn, and reads back the last image of an offscreen context. Fails with
    /// [`GpuError::DeviceLost`](crate::gpu::GpuError::DeviceLost) while the device is lost: the next frames replace it,
    /// upload everything again, and draw.
    pub fn read_back(&mut self, context: ContextId) -> Result<RgbaImage, ViewerError> {
        self.frame.read_back(context)
    }

    /// Waits until all frames are drawn, and returns a view of the texture that an offscreen context draws into: the last
    /// frame, in `Rgba8UnormSrgb`, opaque, with the first row on top. Sample it in commands that are submitted before the
    /// next frame, and ask again after a resize. Useful on a device of the application
    /// ([`GraphicsContext::new_on_device`](crate::gpu::GraphicsContext::new_on_device)); `None` for a window.
    pub fn color_view(&mut self, context: ContextId) -> Result<Option<wgpu::TextureView>, ViewerError> {
        self.frame.color_view(context)
    }

    /// Returns the number and the times of the last frame.
    pub fn frame_stamp(&self) -> FrameStamp {
        self.frame.stamp()
    }

    /// Returns the statistics of the frames so far, over all views.
    pub fn stats(&self) -> &StatsHistory {
        self.frame.results().history()
    }

    /// Switches statistics on, as they are at first, or off: [`Self::stats`] is then empty. Figures so far are dropped.
    pub fn set_stats(&mut self, is_on: bool) {
        self.frame.results.set_stats(is_on);
    }

    /// Returns the milliseconds that the last frame's cull of a view's master camera, or of a slave, took; `None` when the view
    /// has no such camera.
    pub fn cull_ms(&self, view: ViewId, slave: Option<SlaveId>) -> Result<Option<f64>, ViewerError> {
        let camera = self.camera_number(view, slave)?;
        let of_camera = self.frame.rendering.outcomes().find(|(number, _)| Some(*number) == camera);
        Ok(of_camera.map(|(_, outcome)| outcome.cull_ms))
    }

    /// Returns the number of a view's master camera or of a slave.
    pub(super) fn camera_number(&self, view: ViewId, slave: Option<SlaveId>) -> Result<Option<u32>, ViewerError> {
        let of_view = self.view(view)?;
        let camera = slave.map_or(of_view.master.map(|slot| slot.camera), |slave| Some(slave.0));
        Ok(camera.filter(|camera| of_view.has_camera(*camera)))
    }

    /// Returns the problems while drawing so far, each once, including errors that the device reported.
    pub fn draw_errors(&self) -> &[String] {
        self.frame.results().errors()
    }

    /// Returns the largest number of bytes that the GPU pools held so far.
    pub(super) fn gpu_bytes_peak(&self) -> u64 {
        self.frame.results().gpu_bytes_peak()
    }

    /// Sets [`ViewerConfig::compile_budget`] from the next frame on.
    pub fn set_compile_budget(&mut self, budget: CompileBudget) {
        self.frame.set_compile_budget(budget);
    }

    /// Sets [`ViewerConfig::environment_changes`] from the next frame on.
    pub fn set_environment_changes(&mut self, changes: EnvironmentChanges) {
        self.frame.set_environment_changes(changes);
    }

    /// Returns the threading model that runs, or will run from the first frame on.
    pub fn threading_model(&self) -> ThreadingModel {
        self.frame.threading_model()
    }

    /// Changes the threading model. Waits until all frames are drawn and ends the threads; the next frame starts those of
    /// the new model.
    pub fn set_threading_model(&mut self, model: ThreadingModel) -> Result<(), ViewerError> {
        self.frame.set_threading_model(model)
    }

    /// Starts the threads of the model; otherwise the first frame does.
    pub fn start_threading(&mut self) -> Result<(), ViewerError> {
        self.frame.rendering.start_threads()
    }

    /// Waits until all frames are drawn and ends the threads; the next frame starts them again.
    pub fn stop_threading(&mut self) -> Result<(), ViewerError> {
        self.frame.finish()?;
        self.frame.rendering.stop_threads();
        Ok(())
    }
}

/// Access for [`Viewer`](super::Viewer), whose view and scene always exist.
impl CompositeViewer {
    pub(super) fn own_parts(&self, view: ViewId) -> (&FrameLoop, &View, &PagedScene) {
        let view = &self.views[view];
        (&self.frame, view, &self.scenes[view.scene()])
    }

    pub(super) fn own_parts_mut(&mut self, view: ViewId) -> (&mut FrameLoop, &mut View, &mut PagedScene) {
        let view = &mut self.views[view];
        let scene = &mut self.scenes[view.scene()];
        (&mut self.frame, view, scene)
    }

    /// Prepares a view for its context's size at once instead of in the next frame.
    pub(super) fn prepare_view(&mut self, view: ViewId) {
        let view = &mut self.views[view];
        view.prepare(&self.frame.rendering, self.scenes[view.scene()].bounds());
    }

    /// Fits the views to the sizes of their contexts, which the next frame would do.
    pub(super) fn prepare_views(&mut self) {
        for view in self.views.values_mut() {
            view.prepare(&self.frame.rendering, self.scenes[view.scene()].bounds());
        }
    }

    /// Returns true when the pager of a view's scene is idle and the last frame showed everything.
    pub(super) fn has_loaded_all(&self, view: ViewId) -> bool {
        let scene = &self.scenes[self.views[view].scene()];
        self.frame.pager_of(scene).is_settled(&self.scenes)
    }
}
