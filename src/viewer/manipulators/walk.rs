//! Keys that are held, and looking around: what flying, walking and driving share.

use std::f64::consts::PI;

use glam::{DAffine3, DVec3};

use super::inertia::left_after;
use super::{ManipulatorView, heading_and_pitch, looking};
use crate::viewer::events::{EventKind, GuiEventAdapter, Key, MouseButton, YOrientation};

/// Steepest look up or down.
pub(super) const MOST_PITCH: f64 = 89.0 * PI / 180.0;
/// In this time the speed comes 63 % nearer to what the keys ask for.
const SPEEDS_UP_S: f64 = 0.12;

/// Keys of movement that are held, and the push that follows them smoothly.
///
/// Arrows and page keys move at any time. W, S, A, D, Q and E move while a button of the pointer is held; without it
/// they are the handlers' keys. A key that comes and goes within one frame counts as held for that frame: nothing that is
/// typed is lost where frames are slow.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Push {
    held: [bool; 6],
    /// Pressed since the last [`Self::end_frame`].
    tapped: [bool; 6],
    /// Right, up and back, each -1 to 1: where the keys push.
    pub now: DVec3,
    /// What something else than keys asks for besides.
    pub lever: DVec3,
}

impl Push {
    /// True when the event is a movement key.
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

    /// All steps of a frame of so many seconds are made.
    pub fn end_frame(&mut self, dt_s: f64) {
        if dt_s > 0.0 {
            self.tapped = [false; 6];
        }
    }

    /// What the keys ask for.
    pub fn wanted(&self) -> DVec3 {
        let push = |way: usize| f64::from(u8::from(self.held[way] || self.tapped[way]));
        let [right, left, up, down, back, ahead] = std::array::from_fn(push);
        let keys = DVec3::new(right - left, up - down, back - ahead).normalize_or_zero();
        (keys + self.lever).clamp_length_max(1.0)
    }

    /// The mean push over a step of time, at whose end it is [`Self::now`].
    pub fn step(&mut self, step_s: f64) -> DVec3 {
        let wanted = self.wanted();
        let left = left_after(step_s, SPEEDS_UP_S);
        let off = self.now - wanted;
        self.now = wanted + off * left;
        if self.now.length() < 1e-4 && wanted == DVec3::ZERO {
            self.now = DVec3::ZERO;
        }
        let share = if step_s > 0.0 { SPEEDS_UP_S * (1.0 - left) / step_s } else { 1.0 };
        wanted + off * share
    }

    pub fn is_moving(&self) -> bool {
        self.now != DVec3::ZERO || self.wanted() != DVec3::ZERO
    }

    pub fn stop(&mut self) {
        *self = Self::default();
    }
}

/// Turns the direction of view with the pointer, so that what was under it stays there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Look {
    /// Radians clockwise from north.
    pub heading: f64,
    /// Radians above the horizon.
    pub pitch: f64,
    last: Option<(f64, f64)>,
}

impl Look {
    /// True when the event is a piece of a drag with the left or right button.
    pub fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        let position = event.state.position;
        let down = |button| event.state.buttons.contains(button);
        match event.kind {
            EventKind::Push(_) | EventKind::DoubleClick(_) => {
                self.last = Some((position.x, position.y));
                false
            }
            EventKind::Drag if down(MouseButton::Left) || down(MouseButton::Right) => {
                let Some((x, y)) = self.last.replace((position.x, position.y)) else { return false };
                let height = event.state.max.y - event.state.min.y;
                if height <= 0.0 {
                    return false;
                }
                let radians_per_px = view.camera.fovy(view.size_px) / height;
                let up = match event.state.y_orientation {
                    YOrientation::IncreasingUpwards => y - position.y,
                    YOrientation::IncreasingDownwards => position.y - y,
                };
                self.turn((x - position.x) * radians_per_px, up * radians_per_px);
                true
            }
            EventKind::Release(_) => {
                self.last = None;
                false
            }
            _ => false,
        }
    }

    /// Turns, radians clockwise and up.
    pub fn turn(&mut self, heading: f64, pitch: f64) {
        if heading.is_finite() && pitch.is_finite() {
            self.heading = (self.heading + heading).rem_euclid(2.0 * PI);
            self.pitch = (self.pitch + pitch).clamp(-MOST_PITCH, MOST_PITCH);
        }
    }

    /// The pose of an eye at a position.
    pub fn pose(&self, position: DVec3, view: &ManipulatorView<'_>) -> DAffine3 {
        looking(&view.frame_at(position).world_from_local.matrix3, position, self.heading, self.pitch)
    }

    /// Looks as a pose does.
    pub fn set_pose(&mut self, pose: &DAffine3, view: &ManipulatorView<'_>) {
        self.set(heading_and_pitch(&view.frame_at(pose.translation).world_from_local.matrix3, pose));
    }

    pub fn set(&mut self, (heading, pitch): (f64, f64)) {
        if heading.is_finite() && pitch.is_finite() {
            self.heading = heading.rem_euclid(2.0 * PI);
            self.pitch = pitch.clamp(-MOST_PITCH, MOST_PITCH);
        }
        self.last = None;
    }
}

/// A factor of speed after some notches of the wheel.
pub(super) fn faster(factor: f64, notches: f64) -> f64 {
    (factor * 1.25f64.powf(notches.clamp(-20.0, 20.0))).clamp(0.01, 100.0)
}
