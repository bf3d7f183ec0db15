//! Flying freely.

use glam::{DAffine3, DVec3};

use super::inertia::steps;
use super::orbit::turned_by;
use super::touch::{Fingers, Pinch, Touched};
use super::walk::{Look, Push, faster};
use super::{CameraManipulator, ManipulatorView, carried, usage};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};

/// What fingers hold lies so many seconds ahead.
const REACH_S: f64 = 2.0;

/// Flies like a free camera: keys move along the view, dragging looks around, the wheel changes the speed.
///
/// The speed is proportional to the height above the set's top (and to the distance, outside), so that one key works
/// from orbit to the ground.
#[derive(Clone, Copy, Debug)]
pub struct FlyManipulator {
    position: DVec3,
    look: Look,
    push: Push,
    fingers: Fingers,
    /// Factor set by the wheel.
    pub speed_factor: f64,
}

impl Default for FlyManipulator {
    fn default() -> Self {
        Self {
            position: DVec3::ZERO,
            look: Look::default(),
            push: Push::default(),
            fingers: Fingers::default(),
            speed_factor: 1.0,
        }
    }
}

impl FlyManipulator {
    /// Metres per second at the present place.
    pub fn speed_m_per_s(&self, view: &ManipulatorView<'_>) -> f64 {
        let bounds = &view.bounds;
        let radius_m = bounds.sphere.radius_m.max(1e-3);
        let outside_m = self.position.distance(bounds.sphere.center) - radius_m;
        let height_m = bounds.height_above_top_m(self.position);
        // Half a height a second; never so slow that crossing the set takes more than five minutes.
        self.speed_factor * (0.5 * height_m.max(outside_m)).max(radius_m / 150.0)
    }

    /// Moves so that what is under the fingers stays there, at the distance that is flown in [`REACH_S`].
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let before = view.frame_at(self.position);
        let axes = self.look.pose(self.position, view).matrix3;
        let reach_m = REACH_S * self.speed_m_per_s(view);
        let ahead = (pinch.from * view.picture_height()).extend(-1.0);
        let aside = (-pinch.shift() * view.picture_height()).extend(0.0);
        self.look.turn(turned_by(pinch.twist, self.look.pitch), 0.0);
        let moved = self.position + axes * (ahead * pinch.stretch + aside) * reach_m;
        if moved.is_finite() {
            self.position = moved;
            self.look.heading = carried(self.look.heading, &before, &view.frame_at(moved));
        }
    }
}

impl CameraManipulator for FlyManipulator {
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
        for _ in 0..count {
            if let Some(pinch) = self.fingers.advance(step_s) {
                self.pinch(&pinch, view);
            }
            let push = self.push.step(step_s);
            if push == DVec3::ZERO {
                continue;
            }
            let before = view.frame_at(self.position);
            let moved = self.position
                + self.look.pose(self.position, view).matrix3 * push * (self.speed_m_per_s(view) * step_s);
            if moved.is_finite() {
                self.position = moved;
                self.look.heading = carried(self.look.heading, &before, &view.frame_at(moved));
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
        }
    }

    fn is_moving(&self) -> bool {
        self.push.is_moving() || self.fingers.is_moving()
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            usage("Drag", "look around"),
            usage("Arrows, page keys", "fly"),
            usage("W A S D Q E while dragging", "fly"),
            usage("Two fingers", "fly along, up, aside, and turn"),
            usage("Wheel", "faster or slower"),
        ]
    }
}
