//! Positions on the sphere: the unit vectors of a row of longitudes at one latitude.
//!
//! The bits are the same on every machine: sine and cosine are own polynomials, and nothing is fused.

use std::f64::consts::{FRAC_2_PI, PI};

/// The radius of the sphere that the noise is sampled on, in metres. Noise does not need an ellipsoid.
pub(super) const RADIUS_M: f64 = 6_371_000.0;

/// Adding and subtracting this number rounds a number below 2^31 to a whole one, whose low bits are those of the sum.
pub(super) const ROUND: f64 = 6_755_399_441_055_744.0;

/// Returns the sine and the cosine of an angle in radians within -100..100, to 1e-15.
pub(super) fn sin_cos(angle: f64) -> (f64, f64) {
    let turns = angle * FRAC_2_PI + ROUND;
    let quadrant = turns.to_bits() & 3;
    let x = angle - (turns - ROUND) * (0.5 * PI);
    let q = x * x;
    // Taylor's series up to x^17 and x^16; |x| is at most pi / 4.
    let sine = |q: f64| {
        let tail = 1.0 / 6_227_020_800.0 - q * (1.0 / 1_307_674_368_000.0 - q / 355_687_428_096_000.0);
        let mid = 1.0 / 362_880.0 - q * (1.0 / 39_916_800.0 - q * tail);
        x * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5_040.0 - q * mid))))
    };
    let cosine = |q: f64| {
        let tail = 1.0 / 479_001_600.0 - q * (1.0 / 87_178_291_200.0 - q / 20_922_789_888_000.0);
        let mid = 1.0 / 40_320.0 - q * (1.0 / 3_628_800.0 - q * tail);
        1.0 - q * (0.5 - q * (1.0 / 24.0 - q * (1.0 / 720.0 - q * mid)))
    };
    let (s, c) = (sine(q), cosine(q));
    match quadrant {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

/// A row of points on the unit sphere, and the direction north at each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Points {
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub z: Vec<f64>,
    /// The sine of the latitude, the same for the whole row.
    pub sin_latitude: f64,
}

impl Points {
    /// Computes the points of a row. `meridians` are the sines and cosines of its longitudes.
    pub fn set_row(&mut self, meridians: &[(f64, f64)], latitude: f64) {
        let (sin, cos) = sin_cos(latitude);
        self.x.clear();
        self.y.clear();
        self.z.clear();
        self.x.extend(meridians.iter().map(|(_, c)| c * cos));
        self.y.extend(meridians.iter().map(|(s, _)| s * cos));
        self.z.resize(meridians.len(), sin);
        self.sin_latitude = sin;
    }

    pub fn len(&self) -> usize {
        self.x.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_exact_enough() {
        for k in -4000..4000 {
            let angle = f64::from(k) * 0.00213;
            let (s, c) = sin_cos(angle);
            assert!((s - angle.sin()).abs() < 1e-14 && (c - angle.cos()).abs() < 1e-14, "{angle}: {s} {c}");
        }
    }
}
