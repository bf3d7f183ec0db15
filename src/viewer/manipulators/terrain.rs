//! Over terrain: the point looked at stays on the ground, the eye above it.

use std::f64::consts::FRAC_PI_2;

use glam::{DAffine3, DQuat, DVec2, DVec3};

use super::ground::level_under;
use super::inertia::left_after;
use super::orbit::{Around, Shift, distance_to_middle};
use super::touch::Pinch;
use super::{CameraManipulator, ManipulatorView, carried, usage};
use crate::math::WGS84;
use crate::viewer::camera::world_from_eye;
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};

/// The eye keeps this share of its distance as height above the ground, at least.
const LEAST_SHARE: f64 = 0.02;
/// Nearly level: the horizon is seen, but never from below.
const FLATTEST_PITCH: f64 = -0.02;
/// What several fingers hold lies at most so many distances away.
const FARTHEST_HOLD: f64 = 20.0;
/// In this time the point looked at comes 63 % nearer to the ground.
const SETTLES_S: f64 = 0.15;

/// Moves over terrain: a drag moves along the ground, the vertical stays upright, the eye stays above the ground
/// ([`super::GroundHeight`]; above the ellipsoid or plane it moves on where no ground is known); OSG's
/// `TerrainManipulator`.
#[derive(Clone, Copy, Debug)]
pub struct TerrainManipulator {
    /// The eye never comes nearer to the ground, metres.
    pub clearance_m: f64,
    center: DVec3,
    around: Around,
    /// After a move the point looked at comes to the ground.
    is_settling: bool,
}

impl Default for TerrainManipulator {
    fn default() -> Self {
        let around = Around { pitches: [-FRAC_PI_2, FLATTEST_PITCH], ..Around::default() };
        Self { clearance_m: 2.0, center: DVec3::ZERO, around, is_settling: false }
    }
}

impl TerrainManipulator {
    /// The point looked at, world.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Metres from the point to where the eye is, unless the ground lifts it.
    pub fn distance_m(&self) -> f64 {
        self.around.distance_m.value
    }

    /// Moves along the ground so that what was under the pointer stays under it, as near as a plane allows.
    fn pan(&mut self, motion: DVec3, view: &ManipulatorView<'_>) {
        let scale_m = view.picture_height() * self.distance_m();
        let (sin, cos) = self.around.heading.sin_cos();
        // A vertical move in the picture is longer on the ground the flatter one looks.
        let ahead_m = -motion.y * scale_m / (-self.around.pitch).sin().max(0.2);
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
        self.around.heading = carried(self.around.heading, &before, &view.frame_at(moved));
        self.is_settling = true;
    }

    /// Stretches and turns, and moves along the ground so that what was under the middle of the fingers is there again.
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let Some(held) = self.under(pinch.from, view) else {
            // Between the fingers is the sky.
            self.around.stretch_and_twist(pinch);
            self.pan(pinch.shift().extend(0.0), view);
            return;
        };
        self.around.stretch_and_twist(pinch);
        self.is_settling = true;
        // On the ellipsoid the vertical is another elsewhere; in a plane the first round is exact.
        for _ in 0..4 {
            let Some(now) = self.under(pinch.to, view) else { return };
            let before = view.frame_at(self.center);
            let moved = if before.georeferenced {
                let over =
                    DQuat::from_rotation_arc(now.normalize_or(DVec3::Z), held.normalize_or(DVec3::Z)) * self.center;
                let (here, mut there) = (WGS84.geodetic(self.center), WGS84.geodetic(over));
                there.height_m = here.height_m;
                WGS84.ecef(&there)
            } else {
                self.center + (held - now)
            };
            if !moved.is_finite() {
                return;
            }
            self.center = moved;
            self.around.heading = carried(self.around.heading, &before, &view.frame_at(moved));
        }
    }

    /// The place at the level of the point looked at that is seen at a place of the picture.
    fn under(&self, at: DVec2, view: &ManipulatorView<'_>) -> Option<DVec3> {
        let pose = self.around.pose(&view.frame_at(self.center).world_from_local.matrix3, self.center);
        let direction = pose.matrix3 * (at * view.picture_height()).extend(-1.0);
        let met = level_under(view, self.center, pose.translation, direction)?;
        (met.distance(pose.translation) < FARTHEST_HOLD * self.distance_m()).then_some(met)
    }

    fn shift(&mut self, shift: Shift, view: &ManipulatorView<'_>) {
        match shift {
            Shift::None => {}
            Shift::Pan(motion) => self.pan(motion, view),
            Shift::Pinch(pinch) => self.pinch(&pinch, view),
        }
    }

    fn settle(&mut self, dt_s: f64, view: &ManipulatorView<'_>) {
        let Some(ground) = view.ground_at(self.center) else {
            self.is_settling = false;
            return;
        };
        let left = self.center - ground;
        self.is_settling = left.length() > 1e-4 * self.distance_m();
        self.center = if self.is_settling { ground + left * left_after(dt_s, SETTLES_S) } else { ground };
    }

    /// The pose, from above the ground.
    fn pose(&self, view: &ManipulatorView<'_>) -> DAffine3 {
        let pose = self.around.pose(&view.frame_at(self.center).world_from_local.matrix3, self.center);
        let eye = pose.translation;
        let least_m = self.clearance_m.max(LEAST_SHARE * self.distance_m().min(1e4));
        match view.height_above_ground_m(eye) {
            Some(height_m) if height_m < least_m => {
                let up = view.frame_at(eye).up();
                let lifted = eye + up * (least_m - height_m);
                world_from_eye(lifted, self.center - lifted, up)
            }
            _ => pose,
        }
    }
}

impl CameraManipulator for TerrainManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        if let EventKind::DoubleClick(_) = event.kind {
            // Towards what is under the pointer.
            let at = event.state.normalized();
            let motion = DVec3::new(
                -0.5 * at.x * f64::from(view.size_px[0]) / f64::from(view.size_px[1].max(1)),
                -0.5 * at.y,
                0.0,
            );
            self.around.handle(event);
            self.pan(motion, view);
            self.around.distance_m.scale(0.5);
            return true;
        }
        let shift = self.around.handle(event);
        shift.into_iter().for_each(|shift| self.shift(shift, view));
        shift.is_some()
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let shift = self.around.advance(dt_s);
        self.shift(shift, view);
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
        let mut distance_m = distance_to_middle(world_from_eye, view);
        // To the ground where the line of view meets it.
        for _ in 0..8 {
            let at = world_from_eye.translation + direction * distance_m;
            let steepness = -direction.dot(view.frame_at(at).up());
            match view.height_above_ground_m(at) {
                Some(height_m) if steepness > 0.05 => distance_m = (distance_m + height_m / steepness).max(1.0),
                _ => break,
            }
        }
        self.around.distance_m.set(distance_m);
        self.center = world_from_eye.translation + direction * self.distance_m();
        self.around.set_direction(&view.frame_at(self.center).world_from_local.matrix3, world_from_eye);
        // What is loaded later does not move the eye.
        self.is_settling = false;
    }

    fn is_moving(&self) -> bool {
        self.around.is_moving() || self.is_settling
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            usage("Left drag", "turn about the point looked at"),
            usage("Middle drag, Shift+left drag", "move over the ground"),
            usage("Right drag, wheel", "zoom"),
            usage("Two fingers", "move over the ground, zoom and turn"),
            usage("Double click", "towards the place clicked"),
        ]
    }
}
