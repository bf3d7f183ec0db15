//! [`FirstPersonManipulator`]: walks on the ground.

use glam::{DAffine3, DVec3};

use super::look::Look;
use super::move_keys::{MoveKeys, scaled_by_wheel};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};
use crate::viewer::manipulators::manipulator::{CameraManipulator, ManipulatorView};
use crate::viewer::manipulators::motion::{Pinch, PinchTracker, TouchResult, remaining_after, steps};
use crate::viewer::manipulators::pose::heading_change;

/// The time constant with which the eye approaches its height above the ground, seconds.
const RISE_S: f64 = 0.1;
/// The maximum distance of ground that fingers hold on to, in heights of the eye.
const MAX_HOLD_HEIGHTS: f64 = 15.0;
/// The walking speed, metres per second.
const WALK_M_PER_S: f64 = 4.0;

/// Walks on the ground: keys move horizontally, drags look around. Where the ground is unknown the height stays. OSG's
/// `FirstPersonManipulator`.
#[derive(Clone, Copy, Debug)]
pub struct FirstPersonManipulator {
    /// The height of the eye above the ground, metres.
    pub eye_height_m: f64,
    /// The speed factor, set by the wheel.
    pub speed_factor: f64,
    position: DVec3,
    look: Look,
    keys: MoveKeys,
    fingers: PinchTracker,
    /// True until the eye has its height above the ground.
    is_rising: bool,
}

impl Default for FirstPersonManipulator {
    fn default() -> Self {
        Self {
            eye_height_m: 1.7,
            speed_factor: 1.0,
            position: DVec3::ZERO,
            look: Look::default(),
            keys: MoveKeys::default(),
            fingers: PinchTracker::default(),
            is_rising: true,
        }
    }
}

impl FirstPersonManipulator {
    /// Applies a gesture: ground near the eye stays under the fingers, and spreading them walks ahead.
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let slope = pinch.from.y * view.image_height_m();
        let down = (slope.atan() + self.look.pitch).min(0.0).sin().abs();
        let eye_m = self.eye_height_m;
        let reach_m = (eye_m / down).min(MAX_HOLD_HEIGHTS * eye_m) * self.speed_factor;
        let scale_m = view.image_height_m() * reach_m;
        let ahead_m = reach_m * pinch.stretch - pinch.shift().y * scale_m / down.max(0.2);
        self.look.turn(heading_change(pinch.twist, self.look.pitch), 0.0);
        self.walk(-pinch.shift().x * scale_m, ahead_m, 0.0, view);
        self.is_rising = true;
    }

    /// Moves by metres relative to the heading.
    fn walk(&mut self, right_m: f64, ahead_m: f64, up_m: f64, view: &ManipulatorView<'_>) {
        let up = view.frame_at(self.position).up();
        let (sin, cos) = self.look.heading.sin_cos();
        let (east_m, north_m) = (right_m * cos + ahead_m * sin, ahead_m * cos - right_m * sin);
        let moved = view.moved_over(self.position, east_m, north_m) + up * up_m;
        self.look.move_eye(&mut self.position, moved, view);
    }
}

impl CameraManipulator for FirstPersonManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        if let EventKind::Scroll(notches) = event.kind {
            self.speed_factor = scaled_by_wheel(self.speed_factor, notches.y);
            return true;
        }
        if let TouchResult::Pinched(pinch) = self.fingers.handle(event) {
            self.pinch(&pinch, view);
            return true;
        }
        self.keys.handle(event) || self.look.handle(event, view)
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let (count, step_s) = steps(dt_s);
        let speed_m_per_s = self.speed_factor * WALK_M_PER_S;
        for _ in 0..count {
            if let Some(pinch) = self.fingers.advance(step_s) {
                self.pinch(&pinch, view);
            }
            let step_m = self.keys.step(step_s) * (speed_m_per_s * step_s);
            if step_m != DVec3::ZERO {
                self.walk(step_m.x, -step_m.z, step_m.y, view);
            }
            if let Some(height_m) = view.height_above_ground_m(self.position) {
                let off_m = height_m - self.eye_height_m;
                self.is_rising = off_m.abs() > 1e-4;
                let up = view.frame_at(self.position).up();
                let risen = self.position - up * (off_m * (1.0 - remaining_after(step_s, RISE_S)));
                self.look.move_eye(&mut self.position, risen, view);
            } else {
                self.is_rising = false;
            }
        }
        self.keys.end_frame(dt_s);
        self.look.pose(self.position, view)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if world_from_eye.is_finite() {
            self.position = world_from_eye.translation;
            self.look.set_pose(world_from_eye, view);
            self.keys.stop();
            self.fingers.stop();
            self.is_rising = true;
        }
    }

    fn is_moving(&self) -> bool {
        self.keys.is_moving() || self.fingers.is_moving() || self.is_rising
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            Usage::new("Drag", "look around"),
            Usage::new("Arrows", "walk"),
            Usage::new("W A S D while dragging", "walk"),
            Usage::new("Two fingers", "walk and turn"),
            Usage::new("Wheel", "faster or slower"),
        ]
    }
}
