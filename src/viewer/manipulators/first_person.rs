//! Walking.

use glam::{DAffine3, DVec3};

use super::inertia::{left_after, steps};
use super::walk::{Look, Push, faster};
use super::{CameraManipulator, ManipulatorView, carried, usage};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};

/// In this time the eye comes 63 % nearer to its height above the ground.
const RISES_S: f64 = 0.1;
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
            is_rising: true,
        }
    }
}

impl CameraManipulator for FirstPersonManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        if let EventKind::Scroll(notches) = event.kind {
            self.speed_factor = faster(self.speed_factor, notches.y);
            return true;
        }
        self.push.handle(event) || self.look.handle(event, view)
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let (count, step_s) = steps(dt_s);
        let speed_m_per_s = self.speed_factor * WALK_M_PER_S;
        for _ in 0..count {
            let push = self.push.step(step_s) * (speed_m_per_s * step_s);
            let before = view.frame_at(self.position);
            let (sin, cos) = self.look.heading.sin_cos();
            let (right_m, ahead_m) = (push.x, -push.z);
            let mut moved = self.position;
            if push != DVec3::ZERO {
                let (east_m, north_m) = (right_m * cos + ahead_m * sin, ahead_m * cos - right_m * sin);
                moved = view.moved_over(moved, east_m, north_m) + before.up() * push.y;
            }
            if let Some(height_m) = view.height_above_ground_m(moved) {
                let off_m = height_m - self.eye_height_m;
                self.is_rising = off_m.abs() > 1e-4;
                moved -= view.frame_at(moved).up() * (off_m * (1.0 - left_after(step_s, RISES_S)));
            } else {
                self.is_rising = false;
            }
            if moved.is_finite() && moved != self.position {
                self.position = moved;
                self.look.heading = carried(self.look.heading, &before, &view.frame_at(moved));
            }
        }
        self.look.pose(self.position, view)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if world_from_eye.is_finite() {
            self.position = world_from_eye.translation;
            self.look.set_pose(world_from_eye, view);
            self.push.stop();
            self.is_rising = true;
        }
    }

    fn is_moving(&self) -> bool {
        self.push.is_moving() || self.is_rising
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            usage("Drag", "look around"),
            usage("Arrows", "walk"),
            usage("W A S D while dragging", "walk"),
            usage("Wheel", "faster or slower"),
        ]
    }
}
