//! Walking.

use glam::{DAffine3, DVec3};

use super::inertia::{left_after, steps};
use super::orbit::turned_by;
use super::touch::{Fingers, Pinch, Touched};
use super::walk::{Look, Push, faster};
use super::{CameraManipulator, ManipulatorView, carried, usage};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};
use crate::viewer::home::LocalFrame;

/// In this time the eye comes 63 % nearer to its height above the ground.
const RISES_S: f64 = 0.1;
/// Fingers hold ground at most so many heights of the eye away.
const FARTHEST_STEP: f64 = 15.0;
/// Walking speed, metres a second.
const WALK_M_PER_S: f64 = 4.0;

/// Walks on the ground: keys move level, dragging looks around; where no ground is known the height stays. OSG's
/// `FirstPersonManipulator`.
#[derive(Clone, Copy, Debug)]
pub struct FirstPersonManipulator {
    /// Of the eye above the ground, metres.
    pub eye_height_m: f64,
    /// Factor set by the wheel.
    pub speed_factor: f64,
    position: DVec3,
    look: Look,
    push: Push,
    fingers: Fingers,
    is_rising: bool,
}

impl Default for FirstPersonManipulator {
    fn default() -> Self {
        Self {
            eye_height_m: 1.7,
            speed_factor: 1.0,
            position: DVec3::ZERO,
            look: Look::default(),
            push: Push::default(),
            fingers: Fingers::default(),
            is_rising: true,
        }
    }
}

impl FirstPersonManipulator {
    /// Walks so that the ground under the fingers stays there, as far as it is near; apart they walk on towards it.
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let slope = pinch.from.y * view.picture_height();
        let down = (slope.atan() + self.look.pitch).min(0.0).sin().abs();
        let eye_m = self.eye_height_m;
        let reach_m = (eye_m / down).min(FARTHEST_STEP * eye_m) * self.speed_factor;
        let scale_m = view.picture_height() * reach_m;
        let ahead_m = reach_m * pinch.stretch - pinch.shift().y * scale_m / down.max(0.2);
        self.look.turn(turned_by(pinch.twist, self.look.pitch), 0.0);
        self.walk(-pinch.shift().x * scale_m, ahead_m, 0.0, view);
        self.is_rising = true;
    }

    /// So many metres over the ground.
    fn walk(&mut self, right_m: f64, ahead_m: f64, up_m: f64, view: &ManipulatorView<'_>) {
        let before = view.frame_at(self.position);
        let (sin, cos) = self.look.heading.sin_cos();
        let (east_m, north_m) = (right_m * cos + ahead_m * sin, ahead_m * cos - right_m * sin);
        let moved = view.moved_over(self.position, east_m, north_m) + before.up() * up_m;
        self.place(moved, &before, view);
    }

    fn place(&mut self, moved: DVec3, before: &LocalFrame, view: &ManipulatorView<'_>) {
        if moved.is_finite() && moved != self.position {
            self.position = moved;
            self.look.heading = carried(self.look.heading, before, &view.frame_at(moved));
        }
    }
}

impl CameraManipulator for FirstPersonManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        if let EventKind::Scroll(notches) = event.kind {
            self.speed_factor = faster(self.speed_factor, notches.y);
            return true;
        }
        if let Touched::Pinched(pinch) = self.fingers.handle(event) {
            self.pinch(&pinch, view);
            return true;
        }
        self.push.handle(event) || self.look.handle(event, view)
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let (count, step_s) = steps(dt_s);
        let speed_m_per_s = self.speed_factor * WALK_M_PER_S;
        for _ in 0..count {
            if let Some(pinch) = self.fingers.advance(step_s) {
                self.pinch(&pinch, view);
            }
            let push = self.push.step(step_s) * (speed_m_per_s * step_s);
            if push != DVec3::ZERO {
                self.walk(push.x, -push.z, push.y, view);
            }
            if let Some(height_m) = view.height_above_ground_m(self.position) {
                let off_m = height_m - self.eye_height_m;
                self.is_rising = off_m.abs() > 1e-4;
                let here = view.frame_at(self.position);
                let risen = self.position - here.up() * (off_m * (1.0 - left_after(step_s, RISES_S)));
                self.place(risen, &here, view);
            } else {
                self.is_rising = false;
            }
        }
        self.push.end_frame(dt_s);
        self.look.pose(self.position, view)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if world_from_eye.is_finite() {
            self.position = world_from_eye.translation;
            self.look.set_pose(world_from_eye, view);
            self.push.stop();
            self.fingers.stop();
            self.is_rising = true;
        }
    }

    fn is_moving(&self) -> bool {
        self.push.is_moving() || self.fingers.is_moving() || self.is_rising
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            usage("Drag", "look around"),
            usage("Arrows", "walk"),
            usage("W A S D while dragging", "walk"),
            usage("Two fingers", "walk and turn"),
            usage("Wheel", "faster or slower"),
        ]
    }
}
