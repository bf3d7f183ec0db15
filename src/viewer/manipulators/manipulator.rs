//! [`CameraManipulator`], and the view and ground that manipulators may ask.

use glam::{DAffine3, DVec3};

use crate::scene::Scene;
use crate::viewer::camera::Camera;
use crate::viewer::events::{GuiEventAdapter, Usage};
use crate::viewer::view::set_bounds::{LocalFrame, SetBounds};

/// A source of ground heights for manipulators that stay above the ground: [`SceneGround`](super::SceneGround), or a closure.
pub trait GroundHeight {
    /// Returns the ground on the line through `point` along `up` (unit length, world), the highest when there are several;
    /// `None` when the ground is unknown.
    fn ground_at(&self, scene: &Scene, point: DVec3, up: DVec3) -> Option<DVec3>;
}

impl<F: Fn(&Scene, DVec3, DVec3) -> Option<DVec3>> GroundHeight for F {
    fn ground_at(&self, scene: &Scene, point: DVec3, up: DVec3) -> Option<DVec3> {
        self(scene, point, up)
    }
}

/// The scene and camera as a manipulator sees them.
#[derive(Clone, Copy)]
pub struct ManipulatorView<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The camera with the pose of the last frame.
    pub camera: &'a Camera,
    /// The size of the image, pixels.
    pub size_px: [u32; 2],
    /// The bounds of the tile set or model.
    pub bounds: SetBounds,
    /// The source of ground heights.
    pub ground: Option<&'a dyn GroundHeight>,
}

impl ManipulatorView<'_> {
    /// Returns the pose from which the bounds fill the image.
    pub fn home_pose(&self) -> DAffine3 {
        self.bounds.home_camera(self.camera, self.size_px)
    }

    /// Returns the height of the image plane at a distance of 1 m, metres.
    pub fn image_height_m(&self) -> f64 {
        2.0 * (0.5 * self.camera.fovy(self.size_px)).tan()
    }

    /// Returns the local frame at a point: east, north and up.
    pub fn frame_at(&self, point: DVec3) -> LocalFrame {
        LocalFrame::at(point, self.bounds.frame.ellipsoid)
    }

    /// Returns the ground below or above a point; `None` when it is unknown.
    pub fn ground_at(&self, point: DVec3) -> Option<DVec3> {
        let up = self.frame_at(point).up();
        self.ground?.ground_at(self.scene, point, up).filter(|p| p.is_finite())
    }

    /// Returns the height of a point above the ground, metres; `None` when the ground is unknown.
    pub fn height_above_ground_m(&self, point: DVec3) -> Option<f64> {
        let ground = self.ground_at(point)?;
        Some((point - ground).dot(self.frame_at(point).up()))
    }

    /// Returns the point `east_m` and `north_m` metres away, at the same height above the ellipsoid or plane.
    pub fn moved_over(&self, point: DVec3, east_m: f64, north_m: f64) -> DVec3 {
        let frame = self.frame_at(point);
        let offset = frame.world_from_local.matrix3 * DVec3::new(east_m, north_m, 0.0);
        let length_m = offset.length();
        let Some(ellipsoid) = frame.ellipsoid.filter(|_| length_m > 0.0) else { return point + offset };
        // Along the great circle of a sphere through the point; the height is corrected afterwards.
        let radius_m = point.length().max(1.0);
        let (sin, cos) = (length_m / radius_m).sin_cos();
        let there = point * cos + offset / length_m * (radius_m * sin);
        let (here, mut geodetic) = (ellipsoid.geodetic(point), ellipsoid.geodetic(there));
        geodetic.height_m = here.height_m;
        ellipsoid.ecef(&geodetic)
    }
}

/// Moves a camera by events and by time.
pub trait CameraManipulator: Send {
    /// Handles an event that no handler has handled; returns true when the manipulator uses it.
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool;

    /// Advances by `dt_s` seconds and returns the pose (world from eye). Called once per frame, in the update phase.
    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3;

    /// Continues at rest from a pose (world from eye), or from the nearest pose that the manipulator allows.
    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>);

    /// Continues at rest from where the bounds fill the image.
    fn home(&mut self, view: &ManipulatorView<'_>) {
        self.set_pose(&view.home_pose(), view);
    }

    /// Returns false while the pose stays the same without events; drawing on demand asks this.
    fn is_moving(&self) -> bool {
        true
    }

    /// Returns true at the end of a motion that ends by itself, such as a path.
    fn is_finished(&self) -> bool {
        false
    }

    /// Predicts the pose (world from eye) in `seconds` without events, so that tiles are prefetched there. With `None`
    /// the viewer extrapolates the current motion.
    fn pose_after(&self, _seconds: f64) -> Option<DAffine3> {
        None
    }

    /// Takes a line of text to show to the user.
    fn take_notice(&mut self) -> Option<String> {
        None
    }

    /// Returns the manipulator's keys and gestures, for the help.
    fn usage(&self) -> Vec<Usage> {
        Vec::new()
    }
}
