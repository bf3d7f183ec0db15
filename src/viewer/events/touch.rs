//! Touch events: [`EventQueue::touch`] turns fingers into pointer events and gestures.
//!
//! The first finger acts as the pointer with its left button. When a second finger comes down the button is released, because
//! several fingers make a gesture. The last of several fingers acts as the pointer again only after it has moved some way,
//! so that fingers lifted one after the other do not click.

use glam::DVec2;

use super::button::MouseButton;
use super::event::{EventKind, TouchPhase};
use super::fingers::MAX_FINGERS;
use super::queue::EventQueue;

/// The distance that the last of several fingers moves before it drags, pixels.
const RESUME_DRAG_PX: f64 = 12.0;
/// The maximum distance between the two taps of a double click, pixels.
const DOUBLE_TAP_PX: f64 = 40.0;

impl EventQueue {
    /// Queues a touch: a finger comes down, moves or is lifted, at a position in pixels.
    ///
    /// A position that is not finite counts as the finger's last position. Unknown fingers and more than 32 at once are
    /// ignored. A finger that comes down twice without being lifted is cancelled first.
    pub fn touch(&mut self, id: u64, phase: TouchPhase, position_px: DVec2, time_s: f64) {
        let known = self.fingers.down.iter().position(|(finger, _)| *finger == id);
        match (phase, known) {
            (TouchPhase::Began, known) => {
                if let Some(lost) = known {
                    self.lift_finger(lost, TouchPhase::Cancelled, time_s);
                }
                if position_px.is_finite() && self.fingers.down.len() < MAX_FINGERS {
                    self.put_finger(id, position_px, time_s);
                }
            }
            (_, None) => {}
            (TouchPhase::Moved, Some(index)) => {
                if position_px.is_finite() {
                    self.move_finger(index, position_px, time_s);
                }
            }
            (TouchPhase::Ended | TouchPhase::Cancelled, Some(index)) => {
                if let Some((_, last_px)) = self.fingers.down.get_mut(index).filter(|_| position_px.is_finite()) {
                    *last_px = position_px;
                }
                self.lift_finger(index, phase, time_s);
            }
        }
    }

    /// Returns the number of fingers that are down.
    pub fn finger_count(&self) -> usize {
        self.fingers.down.len()
    }

    /// Cancels all fingers.
    pub(super) fn cancel_fingers(&mut self, time_s: f64) {
        while let Some(last) = self.fingers.down.len().checked_sub(1) {
            self.lift_finger(last, TouchPhase::Cancelled, time_s);
        }
    }

    fn put_finger(&mut self, id: u64, position_px: DVec2, time_s: f64) {
        self.fingers.down.push((id, position_px));
        self.fingers.last_remaining_px = None;
        self.add(EventKind::Touch { id, phase: TouchPhase::Began, position_px }, time_s);
        if self.fingers.down.len() == 1 {
            self.fingers.pointer = Some(id);
            // The jump to the finger's position is not a drag.
            self.set_position(position_px);
            self.press(MouseButton::Left, time_s, DOUBLE_TAP_PX);
        } else if self.fingers.pointer.take().is_some() {
            self.mouse_button_release(MouseButton::Left, time_s);
            self.forget_last_push();
        }
    }

    fn move_finger(&mut self, index: usize, position_px: DVec2, time_s: f64) {
        let Some((id, last_px)) = self.fingers.down.get_mut(index) else { return };
        *last_px = position_px;
        let id = *id;
        self.add_motion(EventKind::Touch { id, phase: TouchPhase::Moved, position_px }, time_s);
        if self.fingers.pointer == Some(id) {
            self.mouse_motion(position_px, time_s);
        } else if self.fingers.last_remaining_px.is_some_and(|from| from.distance(position_px) > RESUME_DRAG_PX) {
            self.fingers.last_remaining_px = None;
            self.fingers.pointer = Some(id);
            self.set_position(position_px);
            self.press(MouseButton::Left, time_s, 0.0);
            self.forget_last_push();
        }
    }

    fn lift_finger(&mut self, index: usize, phase: TouchPhase, time_s: f64) {
        let (id, position_px) = self.fingers.down.remove(index);
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
        self.fingers.last_remaining_px = match *self.fingers.down {
            [(_, at_px)] if self.fingers.pointer.is_none() => Some(at_px),
            _ => None,
        };
    }
}
