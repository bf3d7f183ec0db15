//! [`Throw`]: a motion that continues after the pointer lets go, and decays.

use std::ops::{Add, Mul};

use glam::{DVec3, DVec4};

use super::time::remaining_after;

/// The time constant with which a thrown motion slows down, seconds.
const DECAY_S: f64 = 0.25;
/// The time over which the speed of the pointer is averaged, seconds.
const AVERAGING_S: f64 = 0.05;
/// The minimum speed at which a release is a throw, image heights per second.
const MIN_THROW_SPEED: f64 = 0.02;
/// The speed below which a thrown motion ends, image heights per second.
const MIN_SPEED: f64 = 5e-4;

/// Measures a motion, and continues it after its release with decaying speed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Throw<V> {
    /// The motion per second, and the time of its last measurement in seconds.
    speed: Option<(V, f64)>,
    /// True after the release.
    is_released: bool,
}

impl<V> Throw<V>
where
    V: Copy + Default + Add<Output = V> + Mul<f64, Output = V> + Magnitude,
{
    /// Measures a piece of the motion.
    pub fn moved(&mut self, motion: V, time_s: f64) {
        if !(motion.length().is_finite() && time_s.is_finite()) {
            return;
        }
        let (speed, since_s) = self.speed.unwrap_or((V::default(), time_s));
        let remaining = (-(time_s - since_s).max(0.0) / AVERAGING_S).exp();
        self.speed = Some((speed * remaining + motion * (1.0 / AVERAGING_S), time_s));
        self.is_released = false;
    }

    /// Releases the motion: it continues if it is fast enough.
    pub fn release(&mut self, time_s: f64) {
        if let Some((speed, since_s)) = &mut self.speed {
            *speed = *speed * (-(time_s - *since_s).max(0.0) / AVERAGING_S).exp();
            let length = speed.length();
            self.is_released = length.is_finite() && length > MIN_THROW_SPEED;
        }
        if !self.is_released {
            self.stop();
        }
    }

    /// Returns the motion of the next `dt_s` seconds after the release.
    pub fn advance(&mut self, dt_s: f64) -> Option<V> {
        let (speed, _) = self.speed.as_mut().filter(|_| self.is_released)?;
        let remaining = remaining_after(dt_s, DECAY_S);
        let motion = *speed * (DECAY_S * (1.0 - remaining));
        *speed = *speed * remaining;
        if speed.length() < MIN_SPEED {
            self.stop();
        }
        Some(motion)
    }

    /// Ends the motion.
    pub fn stop(&mut self) {
        (self.speed, self.is_released) = (None, false);
    }

    /// Returns true while a released motion continues.
    pub fn is_moving(&self) -> bool {
        self.is_released
    }
}

/// A motion with a length.
pub trait Magnitude {
    fn length(&self) -> f64;
}

impl Magnitude for DVec3 {
    fn length(&self) -> f64 {
        DVec3::length(*self)
    }
}

impl Magnitude for DVec4 {
    fn length(&self) -> f64 {
        DVec4::length(*self)
    }
}
