//! [`FlyManipulator`]: flies freely.

use glam::{DAffine3, DVec3};

use super::look::Look;
use super::move_keys::{MoveKeys, scaled_by_wheel};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};
use crate::viewer::manipulators::manipulator::{CameraManipulator, ManipulatorView};
use crate::viewer::manipulators::motion::{Pinch, PinchTracker, TouchResult, steps};
use crate::viewer::manipulators::pose::heading_change;

/// The time of flight to the point that fingers hold on to, seconds.
const REACH_S: f64 = 2.0;

/// Flies freely: keys move along the direction of view, drags look around, the wheel changes the speed.
///
/// The speed is proportional to the height above the set's top, or to the distance from the set, so that the same keys work
/// from orbit to the ground.
#[derive(Clone, Copy, Debug)]
pub struct FlyManipulator {
    position: DVec3,
    look: Look,
    keys: MoveKeys,
    fingers: PinchTracker,
    /// The speed factor, set by the wheel.
    pub speed_factor: f64,
}

impl Default for FlyManipulator {
    fn default() -> Self {
        Self {
            position: DVec3::ZERO,
            look: Look::default(),
            keys: MoveKeys::default(),
            fingers: PinchTracker::default(),
            speed_factor: 1.0,
        }
    }
}

impl FlyManipulator {
    /// Returns the speed at the current position, metres per second.
    pub fn speed_m_per_s(&self, view: &ManipulatorView<'_>) -> f64 {
        let bounds = &view.bounds;
        let radius_m = bounds.sphere.radius_m.max(1e-3);
        let outside_m = self.position.distance(bounds.sphere.center) - radius_m;
        let height_m = bounds.height_above_top_m(self.position);
        // Half the height per second, and at most five minutes across the set.
        self.speed_factor * (0.5 * height_m.max(outside_m)).max(radius_m / 150.0)
    }

    /// Applies a gesture so that points under the fingers stay there, at the distance that is flown in [`REACH_S`].
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let axes = self.look.pose(self.position, view).matrix3;
        let reach_m = REACH_S * self.speed_m_per_s(view);
        let ahead = (pinch.from * view.image_height_m()).extend(-1.0);
        let aside = (-pinch.shift() * view.image_height_m()).extend(0.0);
        self.look.turn(heading_change(pinch.twist, self.look.pitch), 0.0);
        let moved = self.position + axes * (ahead * pinch.stretch + aside) * reach_m;
        self.look.move_eye(&mut self.position, moved, view);
    }
}

impl CameraManipulator for FlyManipulator {
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
        for _ in 0..count {
            if let Some(pinch) = self.fingers.advance(step_s) {
                self.pinch(&pinch, view);
            }
            let push = self.keys.step(step_s);
            if push == DVec3::ZERO {
                continue;
            }
            let moved = self.position
                + self.look.pose(self.position, view).matrix3 * push * (self.speed_m_per_s(view) * step_s);
            self.look.move_eye(&mut self.position, moved, view);
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
        }
    }

    fn is_moving(&self) -> bool {
        self.keys.is_moving() || self.fingers.is_moving()
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            Usage::new("Drag", "look around"),
            Usage::new("Arrows, page keys", "fly"),
            Usage::new("W A S D Q E while dragging", "fly"),
            Usage::new("Two fingers", "fly along, up, aside, and turn"),
            Usage::new("Wheel", "faster or slower"),
        ]
    }
}
