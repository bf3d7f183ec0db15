//! Pointer drags that go on a little after the button came up, values that ease towards others, and steps of time;
//! all of them functions of time, whatever the frame rate.

use std::ops::{Add, Mul};

use glam::{DVec2, DVec3, DVec4};

use super::touch::{Fingers, Pinch, Touched};
use crate::viewer::events::{EventKind, GuiEventAdapter, InputState, MouseButton};

/// A frame that took longer (a debugger, a suspended machine) must not fling the camera away.
const MOST_S: f64 = 0.5;
/// Longest step of what is integrated.
const STEP_S: f64 = 1.0 / 240.0;
/// In this time a thrown motion loses 63 % of its speed.
const THROW_FADES_S: f64 = 0.25;
/// Over about this time the speed of the pointer is measured.
const MEASURED_OVER_S: f64 = 0.05;
/// Slower throws, in picture heights a second, are no throws.
const SLOWEST_THROW: f64 = 0.02;

/// Seconds that count; what is not a time is none.
pub fn sane_s(dt_s: f64) -> f64 {
    if dt_s > 0.0 { dt_s.min(MOST_S) } else { 0.0 }
}

/// The steps in which a time is integrated: how many, and how long each is.
pub fn steps(dt_s: f64) -> (u32, f64) {
    let dt_s = sane_s(dt_s);
    let count = (dt_s / STEP_S).ceil();
    (count as u32, if count > 0.0 { dt_s / count } else { 0.0 })
}

/// The share of a difference that is left after a time, of what fades with a time constant.
pub fn left_after(dt_s: f64, fades_s: f64) -> f64 {
    (-sane_s(dt_s) / fades_s).exp()
}

/// A length that eases towards another, evenly by factors.
#[derive(Clone, Copy, Debug)]
pub struct Eased {
    /// Now.
    pub value: f64,
    /// In the end.
    pub target: f64,
    least: f64,
    most: f64,
}

impl Eased {
    pub fn new(value: f64, least: f64, most: f64) -> Self {
        let value = if value.is_finite() { value.clamp(least, most) } else { least };
        Self { value, target: value, least, most }
    }

    pub fn set(&mut self, value: f64) {
        *self = Self::new(value, self.least, self.most);
    }

    /// Wants another multiple of what is wanted.
    pub fn scale(&mut self, factor: f64) {
        let target = self.target * factor;
        if target.is_finite() {
            self.target = target.clamp(self.least, self.most);
        }
    }

    /// Becomes smaller by e to a power at once, and stays there; by what power it did.
    pub fn shrink_now(&mut self, power: f64) -> f64 {
        let before = self.value;
        self.set(if power.is_finite() { before * (-power).exp() } else { before });
        (before / self.value).ln()
    }

    pub fn advance(&mut self, dt_s: f64) {
        let eased = self.target * (self.value / self.target).powf(left_after(dt_s, 0.1));
        // Settles, so that what draws on demand comes to rest.
        let is_there = (eased / self.target - 1.0).abs() < 1e-6;
        self.value = if is_there || !eased.is_finite() { self.target } else { eased };
    }

    pub fn is_moving(&self) -> bool {
        self.value != self.target
    }
}

/// What a drag means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gesture {
    /// Left button.
    Rotate,
    /// Middle button, left and right together, or left with Shift.
    Pan,
    /// Right button.
    Zoom,
}

/// A piece of a drag, in picture heights from the middle, y up.
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

/// What the pointer does to the picture.
#[derive(Clone, Copy, Debug)]
pub enum Moved {
    /// It, or a single finger, drags.
    Drag(Drag),
    /// Several fingers move.
    Pinch(Pinch),
}

/// What goes on after the pointer.
#[derive(Clone, Copy, Debug)]
pub enum Thrown {
    /// A motion as a manipulator gave it to [`Pointer::moved`].
    Drag(Gesture, DVec3),
    /// What several fingers did.
    Pinch(Pinch),
}

/// A motion that is measured, let go, and fades.
#[derive(Clone, Copy, Debug, Default)]
pub struct Throw<V> {
    /// Motion a second, and when it was measured.
    speed: Option<(V, f64)>,
    /// Let go.
    is_free: bool,
}

impl<V> Throw<V>
where
    V: Copy + Default + Add<Output = V> + Mul<f64, Output = V> + Length,
{
    /// Measures a piece of motion.
    pub fn moved(&mut self, motion: V, time_s: f64) {
        if !(motion.length().is_finite() && time_s.is_finite()) {
            return;
        }
        let (speed, since_s) = self.speed.unwrap_or((V::default(), time_s));
        let left = (-(time_s - since_s).max(0.0) / MEASURED_OVER_S).exp();
        self.speed = Some((speed * left + motion * (1.0 / MEASURED_OVER_S), time_s));
        self.is_free = false;
    }

    /// Lets go: what is fast enough goes on.
    pub fn release(&mut self, time_s: f64) {
        if let Some((speed, since_s)) = &mut self.speed {
            *speed = *speed * (-(time_s - *since_s).max(0.0) / MEASURED_OVER_S).exp();
            let length = speed.length();
            self.is_free = length.is_finite() && length > SLOWEST_THROW;
        }
        if !self.is_free {
            self.stop();
        }
    }

    /// The motion of a time since it was let go.
    pub fn advance(&mut self, dt_s: f64) -> Option<V> {
        let (speed, _) = self.speed.as_mut().filter(|_| self.is_free)?;
        let left = left_after(dt_s, THROW_FADES_S);
        let motion = *speed * (THROW_FADES_S * (1.0 - left));
        *speed = *speed * left;
        if speed.length() < 5e-4 {
            self.stop();
        }
        Some(motion)
    }

    pub fn stop(&mut self) {
        (self.speed, self.is_free) = (None, false);
    }

    pub fn is_free(&self) -> bool {
        self.is_free
    }
}

/// How long a motion is.
pub trait Length {
    fn length(&self) -> f64;
}

impl Length for DVec3 {
    fn length(&self) -> f64 {
        DVec3::length(*self)
    }
}

impl Length for DVec4 {
    fn length(&self) -> f64 {
        DVec4::length(*self)
    }
}

/// Follows the pointer and the fingers, and goes on after them: a manipulator gives each piece of a drag a motion, and
/// gets such motions back after the release.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pointer {
    last: Option<DVec2>,
    gesture: Option<Gesture>,
    throw: Throw<DVec3>,
    fingers: Fingers,
}

impl Pointer {
    /// Looks at an event; the piece of a drag or of a gesture that it is.
    pub fn handle(&mut self, event: &GuiEventAdapter) -> Option<Moved> {
        match self.fingers.handle(event) {
            Touched::No => {}
            Touched::Rests => {
                self.throw.stop();
                return None;
            }
            Touched::Pinched(pinch) => {
                self.throw.stop();
                return Some(Moved::Pinch(pinch));
            }
        }
        let at = place(event);
        match event.kind {
            EventKind::Push(_) | EventKind::DoubleClick(_) => {
                self.last = Some(at);
                self.throw.stop();
                None
            }
            EventKind::Drag => {
                let from = self.last.replace(at)?;
                let gesture = gesture(event)?;
                (from != at).then_some(Moved::Drag(Drag { gesture, from, to: at }))
            }
            EventKind::Release(_) if event.state.buttons.is_empty() => {
                self.last = None;
                self.throw.release(event.time_s);
                None
            }
            EventKind::Release(_) => {
                // Another gesture begins with the buttons that are left.
                self.last = Some(at);
                self.throw.stop();
                None
            }
            _ => None,
        }
    }

    /// Measures the motion that a piece of a drag was given.
    pub fn moved(&mut self, gesture: Gesture, motion: DVec3, time_s: f64) {
        if self.gesture.replace(gesture) != Some(gesture) {
            self.throw.stop();
        }
        self.throw.moved(motion, time_s);
    }

    /// The motion of a time after the release.
    pub fn advance(&mut self, dt_s: f64) -> Option<Thrown> {
        if let Some(pinch) = self.fingers.advance(dt_s) {
            return Some(Thrown::Pinch(pinch));
        }
        let motion = self.throw.advance(dt_s)?;
        Some(Thrown::Drag(self.gesture?, motion))
    }

    /// Comes to rest; a drag goes on from where the pointer is at its next event.
    pub fn stop(&mut self) {
        self.last = None;
        self.throw.stop();
        self.fingers.stop();
    }

    pub fn is_moving(&self) -> bool {
        self.throw.is_free() || self.fingers.is_moving()
    }
}

/// The pointer in picture heights from the middle, y up.
fn place(event: &GuiEventAdapter) -> DVec2 {
    place_of(event.state.position, &event.state)
}

/// A place of the input range in picture heights from the middle, y up.
pub fn place_of(position_px: DVec2, state: &InputState) -> DVec2 {
    let size = state.max - state.min;
    let aspect = if size.y > 0.0 { size.x / size.y } else { 1.0 };
    let state = InputState { position: position_px, ..*state };
    let at = 0.5 * state.normalized() * DVec2::new(aspect, 1.0);
    if at.is_finite() { at.clamp(DVec2::splat(-100.0), DVec2::splat(100.0)) } else { DVec2::ZERO }
}

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
