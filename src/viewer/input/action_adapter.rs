//! [`GuiActionAdapter`]: the view, scene and viewer that event handlers use and change; OSG's `GUIActionAdapter`. Main thread.

use std::ops::{Deref, DerefMut};

use glam::{DAffine3, DVec3};
use image::RgbaImage;

use crate::math::BoundingSphere;
use crate::pager::{DatabasePager, ImagePager};
use crate::scene::Scene;
use crate::viewer::ViewerError;
use crate::viewer::clock::FrameStamp;
use crate::viewer::frame::FrameLoop;
use crate::viewer::frame::StatsHistory;
use crate::viewer::manipulators::{CameraManipulator, ManipulatorView};
use crate::viewer::paging::PagedScene;
use crate::viewer::rendering::ThreadingModel;
use crate::viewer::view::View;
use crate::viewer::view::set_bounds::SetBounds;

/// Receives a captured image and the number of its frame.
pub type OnPicture = Box<dyn FnOnce(u32, RgbaImage)>;

/// Returns what manipulators may look at.
pub(in crate::viewer) fn manipulator_view<'a>(view: &'a View, paged: &'a PagedScene) -> ManipulatorView<'a> {
    let unit = BoundingSphere::new(DVec3::ZERO, 1.0);
    ManipulatorView {
        scene: paged.scene(),
        camera: &view.camera,
        size_px: view.size_px(),
        bounds: paged.bounds().copied().unwrap_or_else(|| SetBounds::from_sphere(unit)),
        ground: view.input.camera_motion.ground().map(|ground| ground as _),
    }
}

/// A view with its scene and its viewer, as event handlers see them. It dereferences to the [`View`].
pub struct GuiActionAdapter<'a> {
    pub(in crate::viewer) base: &'a mut FrameLoop,
    pub(in crate::viewer) view: &'a mut View,
    pub(in crate::viewer) paged: &'a mut PagedScene,
}

impl Deref for GuiActionAdapter<'_> {
    type Target = View;

    fn deref(&self) -> &View {
        self.view
    }
}

impl DerefMut for GuiActionAdapter<'_> {
    fn deref_mut(&mut self) -> &mut View {
        self.view
    }
}

impl GuiActionAdapter<'_> {
    /// Returns the scene.
    pub fn scene(&self) -> &Scene {
        self.paged.scene()
    }

    /// Returns the scene for changes.
    pub fn scene_mut(&mut self) -> &mut Scene {
        self.paged.scene_mut()
    }

    /// Returns the image pager; `None` until an image sequence is added.
    pub fn image_pager(&self) -> Option<&ImagePager> {
        self.paged.image_pager()
    }

    /// Returns the pager; `None` until a tile set is loaded.
    pub fn pager(&self) -> Option<&DatabasePager> {
        self.base.pager_of(self.paged).pager()
    }

    /// Returns the bounds of the loaded tile set, or of the first root when there is no tile set.
    pub fn bounds(&self) -> Option<&SetBounds> {
        self.paged.bounds()
    }

    /// Returns the number and times of the current frame.
    pub fn frame_stamp(&self) -> FrameStamp {
        self.base.stamp()
    }

    /// Returns the statistics of the frames so far.
    pub fn stats(&self) -> &StatsHistory {
        self.base.results().history()
    }

    /// Returns the threading model in use.
    pub fn threading_model(&self) -> ThreadingModel {
        self.base.rendering.model()
    }

    /// Changes the threading model; waits until all frames in flight are drawn.
    pub fn set_threading_model(&mut self, model: ThreadingModel) -> Result<(), ViewerError> {
        self.base.set_threading_model(model)
    }

    /// Returns what manipulators may look at.
    pub fn manipulator_view(&self) -> ManipulatorView<'_> {
        manipulator_view(self.view, self.paged)
    }

    /// Sets the manipulator, which starts from the camera's current pose.
    pub fn set_manipulator(&mut self, manipulator: Option<Box<dyn CameraManipulator>>) {
        self.view.input.camera_motion.set_manipulator(manipulator);
        let pose = self.view.camera.world_from_eye;
        self.with_manipulator(|manipulator, view| manipulator.set_pose(&pose, view));
    }

    /// Calls a function with the manipulator; returns `None` when there is no manipulator.
    pub fn with_manipulator<R>(
        &mut self,
        act: impl FnOnce(&mut dyn CameraManipulator, &ManipulatorView<'_>) -> R,
    ) -> Option<R> {
        let mut manipulator = self.view.input.camera_motion.take_manipulator()?;
        let result = act(&mut *manipulator, &self.manipulator_view());
        self.view.input.camera_motion.set_manipulator(Some(manipulator));
        Some(result)
    }

    /// Moves the camera to where the bounds fill the image; a manipulator continues from its own home pose.
    pub fn home(&mut self) {
        if self.with_manipulator(|manipulator, view| manipulator.home(view)).is_none() {
            self.view.camera.world_from_eye = self.manipulator_view().home_pose();
        }
    }

    /// Moves the camera to a pose, from which the manipulator continues. A pose that is not finite is ignored.
    pub fn set_pose(&mut self, world_from_eye: &DAffine3) {
        if world_from_eye.is_finite() {
            self.view.camera.world_from_eye = *world_from_eye;
            self.with_manipulator(|manipulator, view| manipulator.set_pose(world_from_eye, view));
        }
    }

    /// Moves the camera to the view's starting pose in the scene, from which the manipulator continues.
    pub(in crate::viewer) fn first_sight(&mut self) {
        if let Some(bounds) = self.paged.bounds().copied() {
            self.view.first_sight(&bounds);
            let pose = self.view.camera.world_from_eye;
            self.with_manipulator(|manipulator, view| manipulator.set_pose(&pose, view));
        }
    }

    /// Captures the image of the next frame (in the event phase: of this frame) and calls `then` with it. Does nothing
    /// while the master camera has no graphics context.
    pub fn capture(&mut self, then: OnPicture) {
        let frame = self.base.stamp().frame + u32::from(!self.view.input.is_in_event_phase);
        if let Some(context) = self.view.context() {
            self.base.capture(context, frame, then);
        }
    }
}
