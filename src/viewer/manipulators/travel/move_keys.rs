//! [`MoveKeys`]: the movement keys that are down, and the speed that follows them smoothly.

use glam::DVec3;

use crate::viewer::events::{EventKind, GuiEventAdapter, Key};
use crate::viewer::manipulators::motion::remaining_after;

/// The time constant with which the speed approaches what the keys ask for, seconds.
const ACCELERATION_S: f64 = 0.12;

/// The movement keys that are down, and the speed that follows them smoothly.
///
/// Arrows and page keys move at any time. W, S, A, D, Q and E move only while a button of the pointer is down; without it
/// they belong to the handlers. A key that is pressed and released within one frame counts as down for that frame, so that
/// slow frames lose no input.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MoveKeys {
    /// The keys that are down: right, left, up, down, back, ahead.
    held: [bool; 6],
    /// The keys that were pressed since the last [`Self::end_frame`].
    tapped: [bool; 6],
    /// The current speed to the right, upwards and backwards, each -1 to 1.
    speed: DVec3,
    /// A speed that fingers ask for in addition to the keys.
    pub lever: DVec3,
}

impl MoveKeys {
    /// Handles an event; returns true when it is a movement key.
    pub fn handle(&mut self, event: &GuiEventAdapter) -> bool {
        let (key, is_down) = match event.kind {
            EventKind::KeyDown { unmodified, .. } => (unmodified, true),
            EventKind::KeyUp { unmodified, .. } => (unmodified, false),
            _ => return false,
        };
        let (way, is_letter) = match key {
            Key::Right => (0, false),
            Key::Left => (1, false),
            Key::PageUp => (2, false),
            Key::PageDown => (3, false),
            Key::Down => (4, false),
            Key::Up => (5, false),
            Key::Char('d') => (0, true),
            Key::Char('a') => (1, true),
            Key::Char('e') => (2, true),
            Key::Char('q') => (3, true),
            Key::Char('s') => (4, true),
            Key::Char('w') => (5, true),
            _ => return false,
        };
        if is_down && is_letter && event.state.buttons.is_empty() {
            return false;
        }
        self.held[way] = is_down;
        self.tapped[way] |= is_down;
        true
    }

    /// Ends a frame of `dt_s` seconds, after its last step.
    pub fn end_frame(&mut self, dt_s: f64) {
        if dt_s > 0.0 {
            self.tapped = [false; 6];
        }
    }

    /// Returns the speed that the keys and the lever ask for; its length is at most 1.
    fn wanted(&self) -> DVec3 {
        let is_pressed = |way: usize| f64::from(u8::from(self.held[way] || self.tapped[way]));
        let [right, left, up, down, back, ahead] = std::array::from_fn(is_pressed);
        let keys = DVec3::new(right - left, up - down, back - ahead).normalize_or_zero();
        (keys + self.lever).clamp_length_max(1.0)
    }

    /// Advances by a step of time, and returns the mean speed during it.
    pub fn step(&mut self, step_s: f64) -> DVec3 {
        let wanted = self.wanted();
        let remaining = remaining_after(step_s, ACCELERATION_S);
        let excess = self.speed - wanted;
        self.speed = wanted + excess * remaining;
        if self.speed.length() < 1e-4 && wanted == DVec3::ZERO {
            self.speed = DVec3::ZERO;
        }
        let share = if step_s > 0.0 { ACCELERATION_S * (1.0 - remaining) / step_s } else { 1.0 };
        wanted + excess * share
    }

    /// Returns true while the speed is not zero or will not be.
    pub fn is_moving(&self) -> bool {
        self.speed != DVec3::ZERO || self.wanted() != DVec3::ZERO
    }

    /// Forgets the keys that are down, and stops.
    pub fn stop(&mut self) {
        *self = Self::default();
    }
}

/// Returns the speed factor after some notches of the wheel: 1.25 per notch, 0.01 to 100.
pub(super) fn scaled_by_wheel(factor: f64, notches: f64) -> f64 {
    (factor * 1.25f64.powf(notches.clamp(-20.0, 20.0))).clamp(0.01, 100.0)
}
