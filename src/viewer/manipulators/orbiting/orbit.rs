//! [`OrbitManipulator`]: orbits a point with the vertical upright.

use glam::{DAffine3, DVec3};

use super::orbit_state::{OrbitState, PointMotion, distance_to_center};
use crate::viewer::events::{GuiEventAdapter, Usage};
use crate::viewer::manipulators::manipulator::{CameraManipulator, ManipulatorView};
use crate::viewer::manipulators::motion::Pinch;

/// Orbits a point with the vertical upright; drags rotate, pan and zoom. OSG's `OrbitManipulator`.
#[derive(Clone, Copy, Debug, Default)]
pub struct OrbitManipulator {
    center: DVec3,
    orbit: OrbitState,
}

impl OrbitManipulator {
    /// Returns the centre of the orbit, in the world.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Returns the distance from the eye to the centre, metres.
    pub fn distance_m(&self) -> f64 {
        self.orbit.distance_m.value
    }

    fn pan(&mut self, motion: DVec3, view: &ManipulatorView<'_>) {
        let pose = self.orbit.pose(&view.frame_at(self.center).world_from_local.matrix3, self.center);
        let moved_m = pose.matrix3 * (-motion * view.image_height_m() * self.distance_m());
        if moved_m.is_finite() {
            self.center += moved_m;
        }
    }

    /// Applies a gesture so that the point under the fingers' centre, in the image plane through the orbit's centre, stays
    /// under it.
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let eye_axes = |manipulator: &Self, center: DVec3| {
            manipulator.orbit.pose(&view.frame_at(center).world_from_local.matrix3, center).matrix3
        };
        let scale_m = view.image_height_m() * self.distance_m();
        let under = self.center + eye_axes(self, self.center) * (pinch.from * scale_m).extend(0.0);
        self.orbit.stretch_and_twist(pinch);
        let scale_m = view.image_height_m() * self.distance_m();
        let mut center = self.center;
        // Iterates, because the vertical at the new centre differs.
        for _ in 0..3 {
            center = under - eye_axes(self, center) * (pinch.to * scale_m).extend(0.0);
        }
        if center.is_finite() {
            self.center = center;
        }
    }

    fn apply(&mut self, motion: PointMotion, view: &ManipulatorView<'_>) {
        match motion {
            PointMotion::None => {}
            PointMotion::Pan(motion) => self.pan(motion, view),
            PointMotion::Pinch(pinch) => self.pinch(&pinch, view),
        }
    }
}

impl CameraManipulator for OrbitManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        let motion = self.orbit.handle(event);
        motion.into_iter().for_each(|motion| self.apply(motion, view));
        motion.is_some()
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let motion = self.orbit.advance(dt_s);
        self.apply(motion, view);
        self.orbit.pose(&view.frame_at(self.center).world_from_local.matrix3, self.center)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if !world_from_eye.is_finite() {
            return;
        }
        self.orbit.distance_m.set(distance_to_center(world_from_eye, view));
        self.center = world_from_eye.translation - world_from_eye.matrix3.z_axis * self.distance_m();
        self.orbit.set_direction(&view.frame_at(self.center).world_from_local.matrix3, world_from_eye);
    }

    fn is_moving(&self) -> bool {
        self.orbit.is_moving()
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            Usage::new("Left drag", "orbit"),
            Usage::new("Middle drag, Shift+left drag", "pan"),
            Usage::new("Right drag, wheel", "zoom"),
            Usage::new("Two fingers", "pan, zoom and turn"),
        ]
    }
}
