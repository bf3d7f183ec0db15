//! Driving.

use glam::{DAffine3, DVec3};

use super::inertia::{left_after, steps};
use super::touch::{Fingers, Pinch, Touched};
use super::walk::{Look, Push, faster};
use super::{CameraManipulator, ManipulatorView, carried, heading_and_pitch, looking, usage};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};

/// In this time the speed comes 63 % nearer to what is asked for.
const SPEEDS_UP_S: f64 = 1.0;
/// In this time the wheels follow the ground by 63 %.
const FOLLOWS_S: f64 = 0.1;
/// Fastest turn, radians a second.
const TURN: f64 = 0.8;
/// Way of the fingers to full speed, picture heights.
const LEVER: f64 = 0.2;
/// Steepest slope that is looked along.
const MOST_SLOPE: f64 = 0.8;

/// Drives over the ground: keys accelerate and steer, the view follows the slope; OSG's `DriveManipulator`.
#[derive(Clone, Copy, Debug)]
pub struct DriveManipulator {
    /// Of the eye above the ground, metres.
    pub eye_height_m: f64,
    /// Factor set by the wheel.
    pub speed_factor: f64,
    position: DVec3,
    speed_m_per_s: f64,
    /// Where it goes: heading, and pitch of the ground.
    heading: f64,
    slope: f64,
    /// Where one looks besides: turned from there.
    look: Look,
    push: Push,
    fingers: Fingers,
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
            push: Push::default(),
            fingers: Fingers::default(),
            is_settling: true,
        }
    }
}

impl DriveManipulator {
    /// Metres a second, backwards negative.
    pub fn speed_m_per_s(&self) -> f64 {
        self.speed_m_per_s
    }

    /// Several fingers hold wheel and lever: up or apart accelerates, aside or turned steers, until they go.
    fn pinch(&mut self, pinch: &Pinch) {
        let lever = &mut self.push.lever;
        let aside = pinch.shift().x - 0.5 * LEVER * pinch.twist;
        let ahead = pinch.shift().y + 0.5 * LEVER * pinch.stretch;
        let moved = *lever + DVec3::new(aside, 0.0, -ahead) / LEVER;
        if moved.is_finite() {
            *lever = moved.clamp(DVec3::NEG_ONE, DVec3::ONE);
        }
    }

    /// The fastest it goes: a thirtieth of the set a second, within what is sensible on the ground.
    fn most_m_per_s(&self, view: &ManipulatorView<'_>) -> f64 {
        self.speed_factor * (view.bounds.sphere.radius_m / 30.0).clamp(5.0, 300.0)
    }

    fn pose(&self, view: &ManipulatorView<'_>) -> DAffine3 {
        let frame = view.frame_at(self.position).world_from_local.matrix3;
        let pitch = (self.slope + self.look.pitch).clamp(-super::walk::MOST_PITCH, super::walk::MOST_PITCH);
        looking(&frame, self.position, self.heading + self.look.heading, pitch)
    }

    fn step(&mut self, step_s: f64, view: &ManipulatorView<'_>) {
        let push = self.push.step(step_s);
        let wanted = -push.z * self.most_m_per_s(view);
        let left = left_after(step_s, SPEEDS_UP_S);
        let off = self.speed_m_per_s - wanted;
        let moved_m = wanted * step_s + off * SPEEDS_UP_S * (1.0 - left);
        self.speed_m_per_s = wanted + off * left;
        if self.speed_m_per_s.abs() < 1e-3 && wanted == 0.0 {
            self.speed_m_per_s = 0.0;
        }
        self.heading += push.x * TURN * step_s;
        let before = view.frame_at(self.position);
        let (sin, cos) = self.heading.sin_cos();
        let level_m = moved_m * self.slope.cos();
        let mut moved = self.position;
        if level_m != 0.0 {
            moved = view.moved_over(moved, level_m * sin, level_m * cos);
        }
        let follows = 1.0 - left_after(step_s, FOLLOWS_S);
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
            let turned = slope.clamp(-MOST_SLOPE, MOST_SLOPE) - self.slope;
            self.slope += turned * follows;
            self.is_settling = off_m.abs() > 1e-4 || turned.abs() > 1e-5;
        }
        if moved.is_finite() && moved != self.position {
            self.position = moved;
            self.heading = carried(self.heading, &before, &view.frame_at(moved));
        }
    }
}

impl CameraManipulator for DriveManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        if let EventKind::Scroll(notches) = event.kind {
            self.speed_factor = faster(self.speed_factor, notches.y);
            return true;
        }
        let touched = self.fingers.handle(event);
        if let Touched::Pinched(pinch) = touched {
            self.pinch(&pinch);
        }
        if self.fingers.count() < 2 {
            self.push.lever = DVec3::ZERO;
        }
        matches!(touched, Touched::Pinched(_)) || self.push.handle(event) || self.look.handle(event, view)
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let (count, step_s) = steps(dt_s);
        for _ in 0..count {
            self.step(step_s, view);
        }
        self.push.end_frame(dt_s);
        self.pose(view)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if world_from_eye.is_finite() {
            self.position = world_from_eye.translation;
            let frame = view.frame_at(self.position).world_from_local.matrix3;
            let (heading, pitch) = heading_and_pitch(&frame, world_from_eye);
            (self.heading, self.slope, self.speed_m_per_s) = (heading, 0.0, 0.0);
            self.look.set((0.0, pitch));
            self.push.stop();
            self.fingers.stop();
            self.is_settling = true;
        }
    }

    fn is_moving(&self) -> bool {
        self.push.is_moving() || self.speed_m_per_s != 0.0 || self.is_settling
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            usage("Up, down", "accelerate, brake and go back"),
            usage("Left, right", "steer"),
            usage("Drag", "look around"),
            usage("Two fingers", "up accelerates, down brakes, aside or turned steers"),
            usage("Wheel", "faster or slower"),
        ]
    }
}
