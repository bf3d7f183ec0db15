//! [`Viewer`]: one view of one scene, in one context or several. Main thread.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use glam::DAffine3;
use image::RgbaImage;

use super::ViewerError;
use super::clock::FrameStamp;
use super::composite::CompositeViewer;
use super::frame::{FrameLoop, StatsHistory, ViewerConfig};
use super::ids::{ContextId, SceneId, SlaveId, ViewId};
use super::input::{GuiActionAdapter, manipulator_view};
use super::manipulators::{CameraManipulator, ManipulatorView};
use super::paging::{LoadedRoot, PagedScene, SceneUpdate};
use super::view::set_bounds::SetBounds;
use super::view::{Slave, View};
use crate::formats::OverlaySet;
use crate::gpu::{ContextTraits, GraphicsContext, HostDevice};
use crate::pager::{DatabasePager, ImagePager, ImageSequence};
use crate::scene::{Page, PageId, Scene};

/// One view of one scene; osgViewer's `Viewer`.
///
/// One thread owns it and calls [`Self::frame`]: that of the event loop if it has windows. Whether other threads cull and draw is
/// decided by [`ViewerConfig::threading`].
///
/// It is a [`CompositeViewer`] with one view, one scene and one context, which always exist. The methods here are
/// shortcuts for them. [`Self::view_mut`] has the camera, the light and the event queue; [`Self::actions`] the manipulator
/// and everything else that event handlers may use; [`Self::composite_mut`] contexts, threads and further views.
///
/// ```no_run
/// # fn main() -> Result<(), terrane::viewer::ViewerError> {
/// use terrane::viewer::{Viewer, ViewerConfig};
/// let mut viewer = Viewer::new_offscreen(&ViewerConfig::default())?;
/// viewer.load("alps/tileset.json")?;
/// while !viewer.is_settled() {
///     viewer.frame()?;
/// }
/// viewer.read_back()?.save("alps.png").ok();
/// # Ok(())
/// # }
/// ```
pub struct Viewer {
    composite: CompositeViewer,
    view: ViewId,
    scene: SceneId,
    context: ContextId,
    converge_s: Option<f64>,
    /// The camera's pose in the first frame; convergence is measured while it has not moved.
    first_pose: Option<DAffine3>,
}

impl Viewer {
    /// Creates a viewer that draws into a texture, of [`ViewerConfig::size_px`].
    ///
    /// # Errors
    /// Fails without an adapter, or if a thread cannot be started.
    pub fn new_offscreen(config: &ViewerConfig) -> Result<Self, ViewerError> {
        Self::new(GraphicsContext::new_offscreen(&config.traits())?, config)
    }

    /// Creates a viewer that draws into a window. Call it on the thread of the event loop.
    /// [`run_window`](super::run_window) opens a window and runs its event loop too.
    pub fn new_window(
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        config: &ViewerConfig,
    ) -> Result<Self, ViewerError> {
        Self::new(GraphicsContext::new_window(target, &config.traits())?, config)
    }

    /// Creates a viewer on a device of the application, which gets each frame as a texture by [`Self::color_view`]. It
    /// draws on the calling thread: another threading model is an error. See [`HostDevice`].
    pub fn new_on_device(host: HostDevice, config: &ViewerConfig) -> Result<Self, ViewerError> {
        Self::new(GraphicsContext::new_on_device(host, &config.traits())?, config)
    }

    /// Creates a viewer on a context of the caller's.
    pub fn new(context: GraphicsContext, config: &ViewerConfig) -> Result<Self, ViewerError> {
        let mut composite = CompositeViewer::new(config)?;
        let context = composite.open_context(context)?;
        let scene = composite.add_scene()?;
        let view = composite.add_own_view(scene, context)?;
        Ok(Self { composite, view, scene, context, converge_s: None, first_pose: None })
    }

    /// Returns the viewer with all its contexts, scenes and views.
    pub fn composite(&self) -> &CompositeViewer {
        &self.composite
    }

    /// Returns the viewer with all its contexts, scenes and views. Views, scenes and contexts can be added; the viewer's own
    /// view and scene cannot be removed.
    pub fn composite_mut(&mut self) -> &mut CompositeViewer {
        &mut self.composite
    }

    /// Returns the view: its camera, light and slaves.
    pub fn view(&self) -> &View {
        self.parts().1
    }

    /// Returns the view for changes, for example of its camera.
    pub fn view_mut(&mut self) -> &mut View {
        self.parts_mut().1
    }

    /// Returns the id of the view in [`Self::composite`].
    pub fn view_id(&self) -> ViewId {
        self.view
    }

    /// Returns the id of the scene in [`Self::composite`].
    pub fn scene_id(&self) -> SceneId {
        self.scene
    }

    /// Returns the context that the viewer was created with, or the first of the windows that
    /// [`View::set_up`] has opened instead.
    pub fn context(&self) -> ContextId {
        self.context
    }

    #[cfg(feature = "window")]
    pub(super) fn set_context(&mut self, context: ContextId) {
        self.context = context;
    }

    pub(super) fn parts(&self) -> (&FrameLoop, &View, &PagedScene) {
        self.composite.own_parts(self.view)
    }

    pub(super) fn parts_mut(&mut self) -> (&mut FrameLoop, &mut View, &mut PagedScene) {
        self.composite.own_parts_mut(self.view)
    }

    /// Returns the view with its scene and viewer, as event handlers get them: to set a manipulator or a pose, or to
    /// capture the next frame.
    pub fn actions(&mut self) -> GuiActionAdapter<'_> {
        let (base, view, paged) = self.parts_mut();
        GuiActionAdapter { base, view, paged }
    }

    /// Returns the camera, its surroundings and the ground as manipulators see them.
    pub fn manipulator_view(&self) -> ManipulatorView<'_> {
        let (_, view, scene) = self.parts();
        manipulator_view(view, scene)
    }

    /// Sets the manipulator that moves the camera; it starts from the present pose.
    pub fn set_manipulator(&mut self, manipulator: Option<Box<dyn CameraManipulator>>) {
        self.actions().set_manipulator(manipulator);
    }
}

/// The scene and its contents; see the methods of [`CompositeViewer`] with the same names.
impl Viewer {
    /// Loads a root tile set (folder, file or URL) into a scene without one, moves the camera to the first view of it, and
    /// fits sun and haze to its size. Blocks until the root is read.
    ///
    /// # Errors
    /// Fails if the root cannot be read or is invalid ([`ViewerError::Io`]), if the scene has one already
    /// ([`ViewerError::HasTileset`]), or if the pager's threads cannot be started. Tiles that fail later fail no call: they are in
    /// [`DatabasePager::errors`].
    pub fn load(&mut self, source: &str) -> Result<PageId, ViewerError> {
        self.composite.load(self.scene, source)
    }

    /// Does the same as [`Self::load`] with a root that was read before the viewer was created.
    pub fn set_root(&mut self, root: LoadedRoot) -> Result<PageId, ViewerError> {
        self.composite.set_root(self.scene, root)
    }

    /// Adds a page of the application as a root; the first root positions the camera.
    pub fn add_root(&mut self, page: Page) -> Result<PageId, ViewerError> {
        self.composite.add_root(self.scene, page)
    }

    /// Removes a root; `None` when it is not a root, or while pages are attached to it. See
    /// [`CompositeViewer::remove_root`].
    pub fn remove_root(&mut self, id: PageId) -> Option<Page> {
        self.composite.remove_root(self.scene, id).ok().flatten()
    }

    /// Gives a scene built by the application a pager that may read the files in a folder and below.
    pub fn page_files_in(&mut self, folder: &Path) -> Result<(), ViewerError> {
        self.composite.page_files_in(self.scene, folder)
    }

    /// Replaces the pager and removes the pages that the old one merged.
    pub fn set_pager(&mut self, pager: DatabasePager) -> Result<(), ViewerError> {
        self.composite.set_pager(self.scene, pager)
    }

    /// Returns the scene for changes. Pages may be added and transforms set between frames.
    pub fn scene_mut(&mut self) -> &mut Scene {
        self.parts_mut().2.scene_mut()
    }

    /// Returns the scene.
    pub fn scene(&self) -> &Scene {
        self.parts().2.scene()
    }

    /// Returns the pager; `None` until a set was loaded.
    pub fn pager(&self) -> Option<&DatabasePager> {
        let (frame, _, scene) = self.parts();
        frame.pager_of(scene).pager()
    }

    /// Returns the pager, to pause it or to stop new requests.
    pub fn pager_mut(&mut self) -> Option<&mut DatabasePager> {
        let (frame, _, scene) = self.parts_mut();
        frame.pagers.of_mut(scene).pager_mut()
    }

    /// Removes every page that the pager merged, and forgets its requests; the next frames load what they need again.
    pub fn clear_pages(&mut self) {
        // Fails for unknown scenes only.
        let _ = self.composite.clear_pages(self.scene);
    }

    /// Returns the overlays; see [`CompositeViewer::overlays`].
    pub fn overlays(&self) -> Option<&Arc<OverlaySet>> {
        self.parts().2.overlays()
    }

    /// Replaces the overlays; see [`CompositeViewer::set_overlays`].
    pub fn set_overlays(&mut self, overlays: Option<Arc<OverlaySet>>) {
        // Fails for unknown scenes only.
        let _ = self.composite.set_overlays(self.scene, overlays);
    }

    /// Shows the images of a sequence in its texture, over simulation time; see [`ImageSequence`].
    pub fn add_image_sequence(&mut self, sequence: &ImageSequence) -> Result<(), ViewerError> {
        self.composite.add_image_sequence(self.scene, sequence)
    }

    /// Returns the image pager; `None` until a sequence was added.
    pub fn image_pager(&self) -> Option<&ImagePager> {
        self.parts().2.image_pager()
    }

    /// Returns the extent of the loaded tile set, or of the first root.
    pub fn bounds(&self) -> Option<&SetBounds> {
        self.parts().2.bounds()
    }

    /// Returns the URI of the root tile set; `None` without one or after it was removed.
    pub fn root_uri(&self) -> Option<&str> {
        self.parts().2.root_uri()
    }

    /// Returns true when the tiles are height tiles; see [`CompositeViewer::is_height_set`].
    pub fn is_height_set(&self) -> bool {
        self.parts().2.is_height_set()
    }

    /// Returns the attributions of what the last frame showed: the `asset.copyright` of tilesets and glTFs, and the credits of
    /// overlays, those of most tiles first. A window shows them with [`CreditsHandler`](super::handlers::CreditsHandler).
    pub fn credits(&self) -> Vec<Arc<str>> {
        self.scene().credits(self.frame_stamp().frame)
    }

    /// Adds a callback for each update phase.
    pub fn on_update(&mut self, callback: SceneUpdate) {
        self.parts_mut().2.on_update(callback);
    }
}

/// Contexts, slaves and frames; see the methods of [`CompositeViewer`] with the same names.
impl Viewer {
    /// Adds a window as a second context with its own device; [`Self::add_slave`] then draws the view in it too. Call it
    /// on the thread of the event loop. See [`CompositeViewer::open_window_on`] for a window that shares the device.
    pub fn open_window(
        &mut self,
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        traits: &ContextTraits,
    ) -> Result<ContextId, ViewerError> {
        self.composite.open_window(target, traits)
    }

    /// Adds a context with its own device, to draw slaves in.
    pub fn open_context(&mut self, context: GraphicsContext) -> Result<ContextId, ViewerError> {
        self.composite.open_context(context)
    }

    /// Returns the open contexts, by screen and position; see [`CompositeViewer::contexts`].
    pub fn contexts(&self) -> impl Iterator<Item = ContextId> {
        self.composite.contexts()
    }

    /// Adds a camera that follows the master camera, in any context.
    pub fn add_slave(&mut self, slave: Slave) -> Result<SlaveId, ViewerError> {
        self.composite.add_slave(self.view, slave)
    }

    /// Removes a slave; returns false when there is no such slave.
    pub fn remove_slave(&mut self, id: SlaveId) -> Result<bool, ViewerError> {
        self.composite.remove_slave(self.view, id)
    }

    /// Sets the size in pixels of the context that the viewer was created with.
    pub fn resize(&mut self, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.resize_context(self.context, size_px)
    }

    /// Sets the size of a context in pixels; [`View::size_px`] follows at once.
    pub fn resize_context(&mut self, context: ContextId, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.composite.resize_context(context, size_px)?;
        self.composite.prepare_view(self.view);
        Ok(())
    }

    /// Renders one frame; simulation time follows the wall clock. In models that overlap frames it returns before the image is drawn.
    ///
    /// # Errors
    /// See [`CompositeViewer::frame`].
    pub fn frame(&mut self) -> Result<(), ViewerError> {
        let seconds = self.parts().0.timer().seconds();
        self.frame_at(seconds)
    }

    /// Renders one frame at a simulation time in seconds, as [`Self::frame`] does.
    pub fn frame_at(&mut self, simulation_time_s: f64) -> Result<(), ViewerError> {
        let start = Instant::now();
        self.composite.frame_at(simulation_time_s)?;
        self.note_convergence(start);
        Ok(())
    }

    fn note_convergence(&mut self, frame_start: Instant) {
        let pose = self.view().camera.world_from_eye;
        let first_pose = *self.first_pose.get_or_insert(pose);
        if self.converge_s.is_none() && first_pose == pose && self.composite.has_loaded_all(self.view) {
            self.converge_s = self.parts().0.timer().seconds_at(frame_start);
        }
    }

    /// Returns the seconds from the first frame to the first one that showed everything with an idle pager; `None` until then,
    /// or when the camera moved before.
    pub fn converge_s(&self) -> Option<f64> {
        self.converge_s
    }

    /// Merges and uploads arrived pages until `deadline`; see [`CompositeViewer::work_until`].
    pub fn work_until(&mut self, deadline: Instant) {
        self.composite.work_until(deadline);
    }

    /// Waits until all frames are drawn, so that statistics and images are complete.
    pub fn finish(&mut self) -> Result<(), ViewerError> {
        self.composite.finish()
    }

    /// Returns true when the last frame showed everything that it wanted and the pager is idle; see
    /// [`CompositeViewer::is_settled`].
    pub fn is_settled(&self) -> bool {
        self.composite.is_settled()
    }

    /// Returns false while another frame would show the same image; see [`CompositeViewer::check_need_to_do_frame`].
    pub fn check_need_to_do_frame(&self) -> bool {
        self.composite.check_need_to_do_frame()
    }

    /// Returns the number and the times of the last frame.
    pub fn frame_stamp(&self) -> FrameStamp {
        self.composite.frame_stamp()
    }

    /// Returns the statistics of the frames so far.
    pub fn stats(&self) -> &StatsHistory {
        self.composite.stats()
    }

    /// Has the next frame read back; see [`Self::take_pictures`].
    pub fn want_picture(&mut self) {
        self.composite.want_picture(self.context);
    }

    /// Returns the images that have arrived, with their frame numbers, in order.
    pub fn take_pictures(&mut self) -> Vec<(u32, RgbaImage)> {
        self.composite.take_pictures(self.context)
    }

    /// Reads back the last image, offscreen; see [`CompositeViewer::read_back`].
    pub fn read_back(&mut self) -> Result<RgbaImage, ViewerError> {
        self.composite.read_back(self.context)
    }

    /// Returns a view of the texture that holds the last frame, offscreen; see [`CompositeViewer::color_view`].
    pub fn color_view(&mut self) -> Result<Option<wgpu::TextureView>, ViewerError> {
        self.composite.color_view(self.context)
    }
}
