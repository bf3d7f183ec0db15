//! A ball around what is looked at, turned by the pointer.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};

use super::inertia::{Eased, Gesture, Moved, Pointer, Thrown};
use super::orbit::{FARTHEST_M, NEAREST_M, NOTCH, distance_to_middle};
use super::touch::Pinch;
use super::{CameraManipulator, ManipulatorView, usage};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};

/// Radius of the ball in picture heights.
const BALL: f64 = 0.4;

/// Turns the view about a point in any way; OSG's `TrackballManipulator`.
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
            distance_m: Eased::new(1.0, NEAREST_M, FARTHEST_M),
            pointer: Pointer::default(),
        }
    }
}

impl TrackballManipulator {
    /// The point looked at, world.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Metres from the eye to the point.
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
                let moved_m = self.world_from_eye * (-motion * view.picture_height() * self.distance_m.value);
                if moved_m.is_finite() {
                    self.center += moved_m;
                }
            }
            Gesture::Zoom => self.distance_m.scale((-3.0 * motion.y).exp()),
        }
    }

    /// What is under each finger, in the plane of the point looked at, stays under it.
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let from_distance_m = self.distance_m.value;
        let factor = self.distance_m.shrink_now(pinch.stretch).exp();
        // What comes to the middle of the picture.
        let middle = pinch.from - DVec2::from_angle(-pinch.twist).rotate(pinch.to) / factor;
        let moved_m = self.world_from_eye * (middle.extend(0.0) * view.picture_height() * from_distance_m);
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

/// The turn of the ball that takes what is under one place to another: axis times radians, in the eye's frame.
fn turn(from: DVec2, to: DVec2) -> DVec3 {
    let (a, b) = (on_ball(from), on_ball(to));
    let axis = a.cross(b).normalize_or_zero();
    // By the length of the way, so that a drag across the ball is half a turn however it is cut.
    axis * (PI * from.distance(to) / (2.0 * BALL)).min(PI)
}

/// The point of the ball in front of a place of the picture; away from it a hyperbola goes on smoothly.
fn on_ball(at: DVec2) -> DVec3 {
    let distance = at.length();
    let z = if distance < BALL * std::f64::consts::FRAC_1_SQRT_2 {
        (BALL * BALL - distance * distance).sqrt()
    } else {
        0.5 * BALL * BALL / distance
    };
    at.extend(z)
}

impl CameraManipulator for TrackballManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        let moved = self.pointer.handle(event);
        if let Some(Moved::Pinch(pinch)) = moved {
            self.pinch(&pinch, view);
            return true;
        }
        if let Some(Moved::Drag(drag)) = moved {
            let motion = match drag.gesture {
                Gesture::Rotate => turn(drag.from, drag.to),
                Gesture::Pan | Gesture::Zoom => drag.delta(),
            };
            self.pointer.moved(drag.gesture, motion, event.time_s);
            self.apply(drag.gesture, motion, view);
            return true;
        }
        match event.kind {
            EventKind::Scroll(notches) => {
                self.distance_m.scale(NOTCH.powf(notches.y.clamp(-50.0, 50.0)));
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
        self.distance_m.set(distance_to_middle(world_from_eye, view));
        self.center = world_from_eye.translation - self.world_from_eye * DVec3::Z * self.distance_m.value;
        self.pointer.stop();
    }

    fn is_moving(&self) -> bool {
        self.pointer.is_moving() || self.distance_m.is_moving()
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            usage("Left drag", "turn the ball"),
            usage("Middle drag, Shift+left drag", "pan"),
            usage("Right drag, wheel", "zoom"),
            usage("Two fingers", "pan, zoom and roll"),
        ]
    }
}
