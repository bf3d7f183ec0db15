//! [`Eased`]: a length that approaches its target smoothly.

use super::time::remaining_after;

/// The time constant of the approach, seconds.
const TIME_CONSTANT_S: f64 = 0.1;

/// A positive length within limits that approaches its target, exponentially in its logarithm.
#[derive(Clone, Copy, Debug)]
pub struct Eased {
    /// The current length.
    pub value: f64,
    /// The length that is approached.
    pub target: f64,
    min: f64,
    max: f64,
}

impl Eased {
    /// Creates a length at rest; a value that is not finite gives `min`.
    pub fn new(value: f64, min: f64, max: f64) -> Self {
        let value = if value.is_finite() { value.clamp(min, max) } else { min };
        Self { value, target: value, min, max }
    }

    /// Sets value and target.
    pub fn set(&mut self, value: f64) {
        *self = Self::new(value, self.min, self.max);
    }

    /// Multiplies the target.
    pub fn scale(&mut self, factor: f64) {
        let target = self.target * factor;
        if target.is_finite() {
            self.target = target.clamp(self.min, self.max);
        }
    }

    /// Divides value and target by e to `power` at once; returns the power that the limits allowed.
    pub fn shrink_now(&mut self, power: f64) -> f64 {
        let before = self.value;
        self.set(if power.is_finite() { before * (-power).exp() } else { before });
        (before / self.value).ln()
    }

    pub fn advance(&mut self, dt_s: f64) {
        let eased = self.target * (self.value / self.target).powf(remaining_after(dt_s, TIME_CONSTANT_S));
        // The value reaches its target in finite time, so that drawing on demand can stop.
        let is_there = (eased / self.target - 1.0).abs() < 1e-6;
        self.value = if is_there || !eased.is_finite() { self.target } else { eased };
    }

    pub fn is_moving(&self) -> bool {
        self.value != self.target
    }
}
