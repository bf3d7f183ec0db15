//! [`TrackballManipulator`]: the pointer turns a ball around the point that the eye looks at. Main thread.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};

use super::orbit_state::{FACTOR_PER_NOTCH, MAX_DISTANCE_M, MIN_DISTANCE_M, distance_to_center};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};
use crate::viewer::manipulators::manipulator::{CameraManipulator, ManipulatorView};
use crate::viewer::manipulators::motion::{Eased, Gesture, Pinch, Pointer, PointerMotion, Thrown};

/// The radius of the ball, image heights.
const BALL_RADIUS: f64 = 0.4;

/// Rotates the view freely about a point; OSG's `TrackballManipulator`.
#[derive(Clone, Copy, Debug)]
pub struct TrackballManipulator {
    center: DVec3,
    world_from_eye: DQuat,
    distance_m: Eased,
    pointer: Pointer,
}

impl Default for TrackballManipulator {
    fn default() -> Self {
        Self {
            center: DVec3::ZERO,
            world_from_eye: DQuat::IDENTITY,
            distance_m: Eased::new(1.0, MIN_DISTANCE_M, MAX_DISTANCE_M),
            pointer: Pointer::default(),
        }
    }
}

impl TrackballManipulator {
    /// Returns the point that the eye looks at, in the world.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Returns the distance from the eye to the point, metres.
    pub fn distance_m(&self) -> f64 {
        self.distance_m.value
    }

    fn apply(&mut self, gesture: Gesture, motion: DVec3, view: &ManipulatorView<'_>) {
        match gesture {
            Gesture::Rotate => {
                let turned = self.world_from_eye * DQuat::from_scaled_axis(-motion);
                if turned.is_finite() {
                    self.world_from_eye = turned.normalize();
                }
            }
            Gesture::Pan => {
                let moved_m = self.world_from_eye * (-motion * view.image_height_m() * self.distance_m.value);
                if moved_m.is_finite() {
                    self.center += moved_m;
                }
            }
            Gesture::Zoom => self.distance_m.scale((-3.0 * motion.y).exp()),
        }
    }

    /// Applies a gesture so that the points under the fingers, in the image plane through the centre, stay there.
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let from_distance_m = self.distance_m.value;
        let factor = self.distance_m.shrink_now(pinch.stretch).exp();
        // The image position that moves to the image's centre.
        let middle = pinch.from - DVec2::from_angle(-pinch.twist).rotate(pinch.to) / factor;
        let moved_m = self.world_from_eye * (middle.extend(0.0) * view.image_height_m() * from_distance_m);
        let turned = self.world_from_eye * DQuat::from_rotation_z(-pinch.twist);
        if moved_m.is_finite() && turned.is_finite() {
            self.center += moved_m;
            self.world_from_eye = turned.normalize();
        }
    }

    fn pose(&self) -> DAffine3 {
        let back = self.world_from_eye * DVec3::Z;
        DAffine3::from_rotation_translation(self.world_from_eye, self.center + back * self.distance_m.value)
    }
}

/// Returns the rotation of the ball that takes the point under one image position to another: the axis in the eye's frame
/// times the angle in radians.
fn ball_rotation(from: DVec2, to: DVec2) -> DVec3 {
    let (a, b) = (on_ball(from), on_ball(to));
    let axis = a.cross(b).normalize_or_zero();
    // The angle is proportional to the distance, so that a drag across the ball is half a turn in any number of pieces.
    axis * (PI * from.distance(to) / (2.0 * BALL_RADIUS)).min(PI)
}

/// Returns the point of the ball under an image position; outside the ball, a hyperbola continues the surface smoothly.
fn on_ball(at: DVec2) -> DVec3 {
    let distance = at.length();
    let z = if distance < BALL_RADIUS * std::f64::consts::FRAC_1_SQRT_2 {
        (BALL_RADIUS * BALL_RADIUS - distance * distance).sqrt()
    } else {
        0.5 * BALL_RADIUS * BALL_RADIUS / distance
    };
    at.extend(z)
}

impl CameraManipulator for TrackballManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        let moved = self.pointer.handle(event);
        if let Some(PointerMotion::Pinch(pinch)) = moved {
            self.pinch(&pinch, view);
            return true;
        }
        if let Some(PointerMotion::Drag(drag)) = moved {
            let motion = match drag.gesture {
                Gesture::Rotate => ball_rotation(drag.from, drag.to),
                Gesture::Pan | Gesture::Zoom => drag.delta(),
            };
            self.pointer.moved(drag.gesture, motion, event.time_s);
            self.apply(drag.gesture, motion, view);
            return true;
        }
        match event.kind {
            EventKind::Scroll(notches) => {
                self.distance_m.scale(FACTOR_PER_NOTCH.powf(notches.y.clamp(-50.0, 50.0)));
                true
            }
            _ => false,
        }
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        self.distance_m.advance(dt_s);
        match self.pointer.advance(dt_s) {
            Some(Thrown::Drag(gesture, motion)) => self.apply(gesture, motion, view),
            Some(Thrown::Pinch(pinch)) => self.pinch(&pinch, view),
            None => {}
        }
        self.pose()
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if !world_from_eye.is_finite() {
            return;
        }
        let DMat3 { x_axis, y_axis, z_axis } = world_from_eye.matrix3;
        self.world_from_eye = DQuat::from_mat3(&DMat3::from_cols(x_axis, y_axis, z_axis)).normalize();
        self.distance_m.set(distance_to_center(world_from_eye, view));
        self.center = world_from_eye.translation - self.world_from_eye * DVec3::Z * self.distance_m.value;
        self.pointer.stop();
    }

    fn is_moving(&self) -> bool {
        self.pointer.is_moving() || self.distance_m.is_moving()
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            Usage::new("Left drag", "turn the ball"),
            Usage::new("Middle drag, Shift+left drag", "pan"),
            Usage::new("Right drag, wheel", "zoom"),
            Usage::new("Two fingers", "pan, zoom and roll"),
        ]
    }
}
