//! Positions on the sphere: the unit vectors of a row of longitudes at one latitude.
//!
//! The bits are the same on every machine: sine and cosine are own polynomials, and nothing is fused.

use std::f64::consts::{FRAC_2_PI, PI};

/// The radius of the sphere that the noise of the earth is sampled on, in metres. Noise does not need an ellipsoid. Spheres of
/// other bodies have the ratio of their equatorial radii.
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

/// A longitude with its sine and cosine.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meridian {
    pub longitude: f64,
    pub sin: f64,
    pub cos: f64,
}

/// Returns the meridians of longitudes.
pub(super) fn meridians(longitudes: impl Iterator<Item = f64>) -> Vec<Meridian> {
    let meridian = |longitude| {
        let (sin, cos) = sin_cos(longitude);
        Meridian { longitude, sin, cos }
    };
    longitudes.map(meridian).collect()
}

/// Returns the point of the unit sphere at a longitude and latitude.
pub(super) fn unit_vector(longitude: f64, latitude: f64) -> [f64; 3] {
    let ((sin_lon, cos_lon), (sin, cos)) = (sin_cos(longitude), sin_cos(latitude));
    [cos_lon * cos, sin_lon * cos, sin]
}

/// Points on the unit sphere. Those of a row of a patch have one latitude.
#[derive(Clone, Debug)]
pub(crate) struct Points {
    /// The radius of the body in metres.
    pub radius_m: f64,
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub z: Vec<f64>,
    /// The longitudes of a row in radians; empty for other points.
    pub longitudes: Vec<f64>,
    /// The latitude of a row in radians, and its sine.
    pub latitude: f64,
    pub sin_latitude: f64,
}

impl Default for Points {
    fn default() -> Self {
        Self::on(RADIUS_M)
    }
}

impl Points {
    /// Creates no points, on a body with a radius in metres.
    pub fn on(radius_m: f64) -> Self {
        let [x, y, z, longitudes] = Default::default();
        Self { radius_m, x, y, z, longitudes, latitude: 0.0, sin_latitude: 0.0 }
    }

    /// Computes the points of a row.
    pub fn set_row(&mut self, meridians: &[Meridian], latitude: f64) {
        let (sin, cos) = sin_cos(latitude);
        self.clear();
        self.x.extend(meridians.iter().map(|m| m.cos * cos));
        self.y.extend(meridians.iter().map(|m| m.sin * cos));
        self.z.resize(meridians.len(), sin);
        self.longitudes.extend(meridians.iter().map(|m| m.longitude));
        self.latitude = latitude;
        self.sin_latitude = sin;
    }

    pub fn clear(&mut self) {
        for buffer in [&mut self.x, &mut self.y, &mut self.z, &mut self.longitudes] {
            buffer.clear();
        }
    }

    /// Adds a point that belongs to no row.
    pub fn push(&mut self, [x, y, z]: [f64; 3]) {
        self.x.push(x);
        self.y.push(y);
        self.z.push(z);
    }

    pub fn at(&self, k: usize) -> [f64; 3] {
        [self.x[k], self.y[k], self.z[k]]
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
