//! Fingers on a touch screen, and which of them is the pointer.
//!
//! The first finger is the pointer with its left button. When a second one comes the button comes up: what several
//! fingers do is a gesture. The last of several fingers is the pointer again once it has moved on by itself, so that
//! fingers lifted one after the other do not click.

use glam::DVec2;

use super::{EventKind, EventQueue, MouseButton, TouchPhase};

/// More fingers than this at once are not taken.
pub(super) const MOST_FINGERS: usize = 32;
/// The last of several fingers moves so far before it drags.
const MOVES_ON_PX: f64 = 12.0;
/// Two taps may be so far from each other and be a double click.
const DOUBLE_TAP_PX: f64 = 40.0;

/// What is known of the fingers that are down.
#[derive(Clone, Debug, Default)]
pub(super) struct Fingers {
    down: Vec<(u64, DVec2)>,
    /// The one that is the pointer.
    pointer: Option<u64>,
    /// Where the last of several was when the others had gone.
    left_over: Option<DVec2>,
}

impl EventQueue {
    /// A finger came, moved or went, at a place in pixels.
    ///
    /// A place that is not finite counts as the finger's last one. Fingers that never came, and more than 32 at once,
    /// are ignored; one that comes again without having gone was lost, and is cancelled first.
    pub fn touch(&mut self, id: u64, phase: TouchPhase, position_px: DVec2, time_s: f64) {
        let known = self.fingers.down.iter().position(|(finger, _)| *finger == id);
        match (phase, known) {
            (TouchPhase::Began, known) => {
                if let Some(lost) = known {
                    self.finger_went(lost, TouchPhase::Cancelled, time_s);
                }
                if position_px.is_finite() && self.fingers.down.len() < MOST_FINGERS {
                    self.finger_came(id, position_px, time_s);
                }
            }
            (_, None) => {}
            (TouchPhase::Moved, Some(place)) => {
                if position_px.is_finite() {
                    self.finger_moved(place, position_px, time_s);
                }
            }
            (TouchPhase::Ended | TouchPhase::Cancelled, Some(place)) => {
                if let Some((_, last_px)) = self.fingers.down.get_mut(place).filter(|_| position_px.is_finite()) {
                    *last_px = position_px;
                }
                self.finger_went(place, phase, time_s);
            }
        }
    }

    /// Fingers that are down.
    pub fn finger_count(&self) -> usize {
        self.fingers.down.len()
    }

    /// All fingers go, and nobody knows where.
    pub(super) fn cancel_fingers(&mut self, time_s: f64) {
        while let Some(last) = self.fingers.down.len().checked_sub(1) {
            self.finger_went(last, TouchPhase::Cancelled, time_s);
        }
    }

    fn finger_came(&mut self, id: u64, position_px: DVec2, time_s: f64) {
        self.fingers.down.push((id, position_px));
        self.fingers.left_over = None;
        self.add(EventKind::Touch { id, phase: TouchPhase::Began, position_px }, time_s);
        if self.fingers.down.len() == 1 {
            self.fingers.pointer = Some(id);
            // The finger did not drag anything on its way here.
            self.set_position(position_px);
            self.press(MouseButton::Left, time_s, DOUBLE_TAP_PX);
        } else if self.fingers.pointer.take().is_some() {
            self.mouse_button_release(MouseButton::Left, time_s);
            self.forget_last_push();
        }
    }

    fn finger_moved(&mut self, place: usize, position_px: DVec2, time_s: f64) {
        let Some((id, last_px)) = self.fingers.down.get_mut(place) else { return };
        *last_px = position_px;
        let id = *id;
        self.add_motion(EventKind::Touch { id, phase: TouchPhase::Moved, position_px }, time_s);
        if self.fingers.pointer == Some(id) {
            self.mouse_motion(position_px, time_s);
        } else if self.fingers.left_over.is_some_and(|from| from.distance(position_px) > MOVES_ON_PX) {
            self.fingers.left_over = None;
            self.fingers.pointer = Some(id);
            self.set_position(position_px);
            self.press(MouseButton::Left, time_s, 0.0);
            self.forget_last_push();
        }
    }

    fn finger_went(&mut self, place: usize, phase: TouchPhase, time_s: f64) {
        let (id, position_px) = self.fingers.down.remove(place);
        self.add(EventKind::Touch { id, phase, position_px }, time_s);
        if self.fingers.pointer == Some(id) {
            self.fingers.pointer = None;
            if phase == TouchPhase::Ended && self.state().position != position_px {
                self.mouse_motion(position_px, time_s);
            }
            self.mouse_button_release(MouseButton::Left, time_s);
            if phase == TouchPhase::Cancelled {
                self.forget_last_push();
            }
        }
        self.fingers.left_over = match *self.fingers.down {
            [(_, at_px)] if self.fingers.pointer.is_none() => Some(at_px),
            _ => None,
        };
    }
}
