//! [`Pointer`]: drags of the pointer, gestures of several fingers, and the throws that follow them.

use glam::{DVec2, DVec3};

use super::image_plane::image_position;
use super::pinch::{Pinch, PinchTracker, TouchResult};
use super::throw::Throw;
use crate::viewer::events::{EventKind, GuiEventAdapter, MouseButton};

/// The meaning of a drag, by the buttons that are down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gesture {
    /// A drag with the left button.
    Rotate,
    /// A drag with the middle button, left and right together, or left with Shift.
    Pan,
    /// A drag with the right button.
    Zoom,
}

/// A piece of a drag, in image heights from the image's centre, y up.
#[derive(Clone, Copy, Debug)]
pub struct Drag {
    pub gesture: Gesture,
    pub from: DVec2,
    pub to: DVec2,
}

impl Drag {
    pub fn delta(&self) -> DVec3 {
        (self.to - self.from).extend(0.0)
    }
}

/// A motion that an event makes.
#[derive(Clone, Copy, Debug)]
pub enum PointerMotion {
    /// The pointer or a single finger drags.
    Drag(Drag),
    /// Several fingers move.
    Pinch(Pinch),
}

/// A motion that continues after the release.
#[derive(Clone, Copy, Debug)]
pub enum Thrown {
    /// A motion as the manipulator passed it to [`Pointer::moved`].
    Drag(Gesture, DVec3),
    /// A gesture of several fingers.
    Pinch(Pinch),
}

/// Tracks the pointer and the fingers, and continues their motion after the release.
///
/// A manipulator converts each piece of a drag into a motion and passes it to [`Self::moved`]. After the release,
/// [`Self::advance`] returns motions of the same kind.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pointer {
    last: Option<DVec2>,
    gesture: Option<Gesture>,
    throw: Throw<DVec3>,
    fingers: PinchTracker,
}

impl Pointer {
    /// Handles an event; returns the motion that it makes.
    pub fn handle(&mut self, event: &GuiEventAdapter) -> Option<PointerMotion> {
        match self.fingers.handle(event) {
            TouchResult::Ignored => {}
            TouchResult::Stopped => {
                self.throw.stop();
                return None;
            }
            TouchResult::Pinched(pinch) => {
                self.throw.stop();
                return Some(PointerMotion::Pinch(pinch));
            }
        }
        let at = image_position(event.state.position, &event.state);
        match event.kind {
            EventKind::Push(_) | EventKind::DoubleClick(_) => {
                self.last = Some(at);
                self.throw.stop();
                None
            }
            EventKind::Drag => {
                let from = self.last.replace(at)?;
                let gesture = gesture(event)?;
                (from != at).then_some(PointerMotion::Drag(Drag { gesture, from, to: at }))
            }
            EventKind::Release(_) if event.state.buttons.is_empty() => {
                self.last = None;
                self.throw.release(event.time_s);
                None
            }
            EventKind::Release(_) => {
                // The buttons that are still down start another gesture.
                self.last = Some(at);
                self.throw.stop();
                None
            }
            _ => None,
        }
    }

    /// Measures the motion into which the manipulator converted a piece of a drag.
    pub fn moved(&mut self, gesture: Gesture, motion: DVec3, time_s: f64) {
        if self.gesture.replace(gesture) != Some(gesture) {
            self.throw.stop();
        }
        self.throw.moved(motion, time_s);
    }

    /// Returns the motion of the next `dt_s` seconds after the release.
    pub fn advance(&mut self, dt_s: f64) -> Option<Thrown> {
        if let Some(pinch) = self.fingers.advance(dt_s) {
            return Some(Thrown::Pinch(pinch));
        }
        let motion = self.throw.advance(dt_s)?;
        Some(Thrown::Drag(self.gesture?, motion))
    }

    /// Stops all motion; a drag continues from the pointer's position at its next event.
    pub fn stop(&mut self) {
        self.last = None;
        self.throw.stop();
        self.fingers.stop();
    }

    pub fn is_moving(&self) -> bool {
        self.throw.is_moving() || self.fingers.is_moving()
    }
}

/// Returns the gesture of the buttons that are down.
fn gesture(event: &GuiEventAdapter) -> Option<Gesture> {
    let down = |button| event.state.buttons.contains(button);
    let (left, right) = (down(MouseButton::Left), down(MouseButton::Right));
    Some(match () {
        _ if down(MouseButton::Middle) || (left && (right || event.state.modifiers.shift)) => Gesture::Pan,
        _ if left => Gesture::Rotate,
        _ if right => Gesture::Zoom,
        _ => return None,
    })
}
