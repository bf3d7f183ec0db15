//! Procedural terrain: domain-warped ridged mountains that rise out of plains with hills and lakes.

use super::source::ElevationSource;
use crate::GenError;
use crate::noise::{fbm, ridged};

/// Mean radius of the earth, to convert angles to metres. Noise does not need an ellipsoid.
const RADIUS_M: f64 = 6_371_000.0;

/// Procedural terrain. The height of a position depends on the seed and the position only.
#[derive(Clone, Copy, Debug)]
pub struct Procedural {
    /// The seed of the noise.
    pub seed: u64,
    /// The cosine of the latitude in the middle of the terrain; it keeps features round.
    pub cos_latitude: f64,
}

impl ElevationSource for Procedural {
    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        let x = longitude * RADIUS_M * self.cos_latitude;
        let y = latitude * RADIUS_M;
        let s = self.seed.wrapping_mul(0x0100_0000_01b3);
        // The plane is warped so that ridges bend and valleys wind.
        let wx = x + 3800.0 * fbm(x / 11_000.0, y / 11_000.0, 4, s ^ 0x11);
        let wy = y + 3800.0 * fbm(x / 11_000.0, y / 11_000.0, 4, s ^ 0x22);
        let range = fbm(wx / 34_000.0, wy / 34_000.0, 3, s ^ 0x33);
        let mask = smooth(-0.18, 0.30, range);
        let hills = fbm(wx / 5_200.0, wy / 5_200.0, 8, s ^ 0x55);
        let broad = fbm(x / 52_000.0, y / 52_000.0, 3, s ^ 0x66);
        let plain = 520.0 + 420.0 * broad + 170.0 * hills * (0.35 + 0.65 * mask);
        if mask == 0.0 {
            return Ok(Some(plain));
        }
        let ridges = ridged(wx / 13_000.0, wy / 13_000.0, 10, s ^ 0x44);
        Ok(Some(plain + mask * (2900.0 * ridges * (0.35 + 0.65 * mask) - 350.0 * (1.0 - mask))))
    }
}

/// Returns 0 below `low`, 1 above `high`, and a smooth step between them.
fn smooth(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
