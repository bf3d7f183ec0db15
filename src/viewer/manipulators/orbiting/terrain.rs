//! [`TerrainManipulator`]: orbits a point on the ground, and keeps the eye above the ground. Main thread.

use std::f64::consts::FRAC_PI_2;

use glam::{DAffine3, DQuat, DVec2, DVec3};

use super::orbit_state::{OrbitState, PointMotion, distance_to_center};
use crate::viewer::camera::world_from_eye;
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};
use crate::viewer::manipulators::ground::intersect_level;
use crate::viewer::manipulators::manipulator::{CameraManipulator, ManipulatorView};
use crate::viewer::manipulators::motion::{Pinch, remaining_after};
use crate::viewer::manipulators::pose::transport_heading;

/// The minimum height of the eye above the ground, as a fraction of its distance from the point.
const MIN_HEIGHT_FRACTION: f64 = 0.02;
/// The maximum pitch, radians: nearly level, so that the horizon is visible but never seen from below.
const MAX_PITCH: f64 = -0.02;
/// The maximum distance of ground that fingers hold on to, in distances from the eye to the point.
const MAX_HOLD_DISTANCES: f64 = 20.0;
/// The time constant with which the point approaches the ground, seconds.
const SETTLES_S: f64 = 0.15;

/// Moves over terrain: a drag moves along the ground, with the vertical upright and the eye above the ground. OSG's
/// `TerrainManipulator`.
///
/// The ground comes from the view's [`GroundHeight`](crate::viewer::manipulators::GroundHeight). Without it the point moves at
/// its own height above the ellipsoid or plane.
#[derive(Clone, Copy, Debug)]
pub struct TerrainManipulator {
    /// The minimum height of the eye above the ground, metres.
    pub clearance_m: f64,
    center: DVec3,
    orbit: OrbitState,
    /// True after a move, until the point has reached the ground.
    is_settling: bool,
}

impl Default for TerrainManipulator {
    fn default() -> Self {
        let orbit = OrbitState { pitch_limits: [-FRAC_PI_2, MAX_PITCH], ..OrbitState::default() };
        Self { clearance_m: 2.0, center: DVec3::ZERO, orbit, is_settling: false }
    }
}

impl TerrainManipulator {
    /// Returns the point that the eye looks at, in the world.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Returns the distance from the point to the eye, metres, before the ground lifts the eye.
    pub fn distance_m(&self) -> f64 {
        self.orbit.distance_m.value
    }

    /// Pans along the ground so that the point under the pointer stays there, in a planar approximation.
    fn pan(&mut self, motion: DVec3, view: &ManipulatorView<'_>) {
        let scale_m = view.image_height_m() * self.distance_m();
        let (sin, cos) = self.orbit.heading.sin_cos();
        // At flat angles a vertical move in the image covers more ground.
        let ahead_m = -motion.y * scale_m / (-self.orbit.pitch).sin().max(0.2);
        let right_m = -motion.x * scale_m;
        let (east_m, north_m) = (right_m * cos + ahead_m * sin, ahead_m * cos - right_m * sin);
        if !(east_m.is_finite() && north_m.is_finite()) {
            return;
        }
        let before = view.frame_at(self.center);
        let moved = view.moved_over(self.center, east_m, north_m);
        if !moved.is_finite() {
            return;
        }
        self.center = moved;
        self.orbit.heading = transport_heading(self.orbit.heading, &before, &view.frame_at(moved));
        self.is_settling = true;
    }

    /// Applies a gesture, and moves along the ground so that the ground under the fingers' centre stays there.
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let Some(held) = self.under(pinch.from, view) else {
            // There is sky between the fingers.
            self.orbit.stretch_and_twist(pinch);
            self.pan(pinch.shift().extend(0.0), view);
            return;
        };
        self.orbit.stretch_and_twist(pinch);
        self.is_settling = true;
        // Iterates, because the vertical differs on the ellipsoid; on a plane the first iteration is exact.
        for _ in 0..4 {
            let Some(now) = self.under(pinch.to, view) else { return };
            let before = view.frame_at(self.center);
            let moved = if let Some(ellipsoid) = before.ellipsoid {
                let over =
                    DQuat::from_rotation_arc(now.normalize_or(DVec3::Z), held.normalize_or(DVec3::Z)) * self.center;
                let (here, mut there) = (ellipsoid.geodetic(self.center), ellipsoid.geodetic(over));
                there.height_m = here.height_m;
                ellipsoid.ecef(&there)
            } else {
                self.center + (held - now)
            };
            if !moved.is_finite() {
                return;
            }
            self.center = moved;
            self.orbit.heading = transport_heading(self.orbit.heading, &before, &view.frame_at(moved));
        }
    }

    /// Returns the point under an image position, at the level of the point that the eye looks at.
    fn under(&self, at: DVec2, view: &ManipulatorView<'_>) -> Option<DVec3> {
        let pose = self.orbit.pose(&view.frame_at(self.center).world_from_local.matrix3, self.center);
        let direction = pose.matrix3 * (at * view.image_height_m()).extend(-1.0);
        let met = intersect_level(view, self.center, pose.translation, direction)?;
        (met.distance(pose.translation) < MAX_HOLD_DISTANCES * self.distance_m()).then_some(met)
    }

    fn apply(&mut self, motion: PointMotion, view: &ManipulatorView<'_>) {
        match motion {
            PointMotion::None => {}
            PointMotion::Pan(motion) => self.pan(motion, view),
            PointMotion::Pinch(pinch) => self.pinch(&pinch, view),
        }
    }

    /// Moves the point towards the ground.
    fn settle(&mut self, dt_s: f64, view: &ManipulatorView<'_>) {
        let Some(ground) = view.ground_at(self.center) else {
            self.is_settling = false;
            return;
        };
        let offset = self.center - ground;
        self.is_settling = offset.length() > 1e-4 * self.distance_m();
        self.center = if self.is_settling { ground + offset * remaining_after(dt_s, SETTLES_S) } else { ground };
    }

    /// Returns the pose, lifted above the ground if necessary.
    fn pose(&self, view: &ManipulatorView<'_>) -> DAffine3 {
        let pose = self.orbit.pose(&view.frame_at(self.center).world_from_local.matrix3, self.center);
        let eye = pose.translation;
        let min_height_m = self.clearance_m.max(MIN_HEIGHT_FRACTION * self.distance_m().min(1e4));
        match view.height_above_ground_m(eye) {
            Some(height_m) if height_m < min_height_m => {
                let up = view.frame_at(eye).up();
                let lifted = eye + up * (min_height_m - height_m);
                world_from_eye(lifted, self.center - lifted, up)
            }
            _ => pose,
        }
    }
}

impl CameraManipulator for TerrainManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        if let EventKind::DoubleClick(_) = event.kind {
            // Moves towards the point under the pointer.
            let at = event.state.normalized();
            let motion = DVec3::new(
                -0.5 * at.x * f64::from(view.size_px[0]) / f64::from(view.size_px[1].max(1)),
                -0.5 * at.y,
                0.0,
            );
            self.orbit.handle(event);
            self.pan(motion, view);
            self.orbit.distance_m.scale(0.5);
            return true;
        }
        let motion = self.orbit.handle(event);
        motion.into_iter().for_each(|motion| self.apply(motion, view));
        motion.is_some()
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let motion = self.orbit.advance(dt_s);
        self.apply(motion, view);
        if self.is_settling {
            self.settle(dt_s, view);
        }
        self.pose(view)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if !world_from_eye.is_finite() {
            return;
        }
        let direction = -world_from_eye.matrix3.z_axis;
        let mut distance_m = distance_to_center(world_from_eye, view);
        // Finds the point where the line of sight meets the ground.
        for _ in 0..8 {
            let at = world_from_eye.translation + direction * distance_m;
            let steepness = -direction.dot(view.frame_at(at).up());
            match view.height_above_ground_m(at) {
                Some(height_m) if steepness > 0.05 => distance_m = (distance_m + height_m / steepness).max(1.0),
                _ => break,
            }
        }
        self.orbit.distance_m.set(distance_m);
        self.center = world_from_eye.translation + direction * self.distance_m();
        self.orbit.set_direction(&view.frame_at(self.center).world_from_local.matrix3, world_from_eye);
        // Finer ground that is loaded later must not move the eye.
        self.is_settling = false;
    }

    fn is_moving(&self) -> bool {
        self.orbit.is_moving() || self.is_settling
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            Usage::new("Left drag", "turn about the point looked at"),
            Usage::new("Middle drag, Shift+left drag", "move over the ground"),
            Usage::new("Right drag, wheel", "zoom"),
            Usage::new("Two fingers", "move over the ground, zoom and turn"),
            Usage::new("Double click", "towards the place clicked"),
        ]
    }
}
