//! [`DriveManipulator`]: drives over the ground and keeps the eye above it. Main thread.

use glam::{DAffine3, DVec3};

use super::look::{Look, MAX_PITCH};
use super::move_keys::{MoveKeys, scaled_by_wheel};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};
use crate::viewer::manipulators::manipulator::{CameraManipulator, ManipulatorView};
use crate::viewer::manipulators::motion::{Pinch, PinchTracker, TouchResult, remaining_after, steps};
use crate::viewer::manipulators::pose::{heading_and_pitch, pose_from_angles, transport_heading};

/// The time constant with which the speed approaches what is asked for, seconds.
const ACCELERATION_S: f64 = 1.0;
/// The time constant with which height and slope follow the ground, seconds.
const SUSPENSION_S: f64 = 0.1;
/// The maximum turn rate, radians per second.
const MAX_TURN_PER_S: f64 = 0.8;
/// The distance that fingers move for full speed, image heights.
const LEVER_LENGTH: f64 = 0.2;
/// The steepest slope that the view follows, radians.
const MAX_SLOPE: f64 = 0.8;

/// Drives over the ground: keys accelerate and steer, and the view follows the slope. OSG's `DriveManipulator`.
#[derive(Clone, Copy, Debug)]
pub struct DriveManipulator {
    /// The height of the eye above the ground, metres.
    pub eye_height_m: f64,
    /// The speed factor, set by the wheel.
    pub speed_factor: f64,
    position: DVec3,
    speed_m_per_s: f64,
    /// The direction of travel, radians clockwise from north.
    heading: f64,
    /// The pitch of the ground ahead, radians.
    slope: f64,
    /// The direction of view relative to the direction of travel.
    look: Look,
    keys: MoveKeys,
    fingers: PinchTracker,
    /// True until height and slope match the ground.
    is_settling: bool,
}

impl Default for DriveManipulator {
    fn default() -> Self {
        Self {
            eye_height_m: 2.0,
            speed_factor: 1.0,
            position: DVec3::ZERO,
            speed_m_per_s: 0.0,
            heading: 0.0,
            slope: 0.0,
            look: Look::default(),
            keys: MoveKeys::default(),
            fingers: PinchTracker::default(),
            is_settling: true,
        }
    }
}

impl DriveManipulator {
    /// Returns the speed, metres per second; negative backwards.
    pub fn speed_m_per_s(&self) -> f64 {
        self.speed_m_per_s
    }

    /// Applies a gesture as a lever: up or apart accelerates, sideways or turned steers, until the fingers are lifted.
    fn pinch(&mut self, pinch: &Pinch) {
        let lever = &mut self.keys.lever;
        let aside = pinch.shift().x - 0.5 * LEVER_LENGTH * pinch.twist;
        let ahead = pinch.shift().y + 0.5 * LEVER_LENGTH * pinch.stretch;
        let moved = *lever + DVec3::new(aside, 0.0, -ahead) / LEVER_LENGTH;
        if moved.is_finite() {
            *lever = moved.clamp(DVec3::NEG_ONE, DVec3::ONE);
        }
    }

    /// Returns the maximum speed, metres per second: a thirtieth of the set's radius per second, 5 to 300 m/s before the speed
    /// factor.
    fn max_speed_m_per_s(&self, view: &ManipulatorView<'_>) -> f64 {
        self.speed_factor * (view.bounds.sphere.radius_m / 30.0).clamp(5.0, 300.0)
    }

    fn pose(&self, view: &ManipulatorView<'_>) -> DAffine3 {
        let frame = view.frame_at(self.position).world_from_local.matrix3;
        let pitch = (self.slope + self.look.pitch).clamp(-MAX_PITCH, MAX_PITCH);
        pose_from_angles(&frame, self.position, self.heading + self.look.heading, pitch)
    }

    fn step(&mut self, step_s: f64, view: &ManipulatorView<'_>) {
        let push = self.keys.step(step_s);
        let wanted = -push.z * self.max_speed_m_per_s(view);
        let remaining = remaining_after(step_s, ACCELERATION_S);
        let excess = self.speed_m_per_s - wanted;
        let moved_m = wanted * step_s + excess * ACCELERATION_S * (1.0 - remaining);
        self.speed_m_per_s = wanted + excess * remaining;
        if self.speed_m_per_s.abs() < 1e-3 && wanted == 0.0 {
            self.speed_m_per_s = 0.0;
        }
        self.heading += push.x * MAX_TURN_PER_S * step_s;
        let before = view.frame_at(self.position);
        let (sin, cos) = self.heading.sin_cos();
        let level_m = moved_m * self.slope.cos();
        let mut moved = self.position;
        if level_m != 0.0 {
            moved = view.moved_over(moved, level_m * sin, level_m * cos);
        }
        let follows = 1.0 - remaining_after(step_s, SUSPENSION_S);
        self.is_settling = false;
        if let Some(height_m) = view.height_above_ground_m(moved) {
            let off_m = height_m - self.eye_height_m;
            moved -= view.frame_at(moved).up() * (off_m * follows);
            let reach_m = 2.0 * self.eye_height_m;
            let ahead = view.moved_over(moved, reach_m * sin, reach_m * cos);
            let slope = match view.height_above_ground_m(ahead) {
                Some(ahead_m) => (height_m - off_m * follows - ahead_m).atan2(reach_m),
                None => 0.0,
            };
            let turned = slope.clamp(-MAX_SLOPE, MAX_SLOPE) - self.slope;
            self.slope += turned * follows;
            self.is_settling = off_m.abs() > 1e-4 || turned.abs() > 1e-5;
        }
        if moved.is_finite() && moved != self.position {
            self.position = moved;
            self.heading = transport_heading(self.heading, &before, &view.frame_at(moved));
        }
    }
}

impl CameraManipulator for DriveManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        if let EventKind::Scroll(notches) = event.kind {
            self.speed_factor = scaled_by_wheel(self.speed_factor, notches.y);
            return true;
        }
        let touched = self.fingers.handle(event);
        if let TouchResult::Pinched(pinch) = touched {
            self.pinch(&pinch);
        }
        if self.fingers.count() < 2 {
            self.keys.lever = DVec3::ZERO;
        }
        matches!(touched, TouchResult::Pinched(_)) || self.keys.handle(event) || self.look.handle(event, view)
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let (count, step_s) = steps(dt_s);
        for _ in 0..count {
            self.step(step_s, view);
        }
        self.keys.end_frame(dt_s);
        self.pose(view)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if world_from_eye.is_finite() {
            self.position = world_from_eye.translation;
            let frame = view.frame_at(self.position).world_from_local.matrix3;
            let (heading, pitch) = heading_and_pitch(&frame, world_from_eye);
            (self.heading, self.slope, self.speed_m_per_s) = (heading, 0.0, 0.0);
            self.look.set((0.0, pitch));
            self.keys.stop();
            self.fingers.stop();
            self.is_settling = true;
        }
    }

    fn is_moving(&self) -> bool {
        self.keys.is_moving() || self.speed_m_per_s != 0.0 || self.is_settling
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            Usage::new("Up, down", "accelerate, brake and go back"),
            Usage::new("Left, right", "steer"),
            Usage::new("Drag", "look around"),
            Usage::new("Two fingers", "up accelerates, down brakes, aside or turned steers"),
            Usage::new("Wheel", "faster or slower"),
        ]
    }
}
