//! The climate along a row of points: temperature at sea level and moisture.

use super::super::points::Points;
use super::super::preset::Climate;
use super::super::relief::{Ground, add_octaves, part_seed, smooth};

/// The climate of a row.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weather {
    /// Temperature at sea level in degrees Celsius.
    pub sea_level_c: Vec<f32>,
    /// Moisture: about 0 in deserts, 1 in rain forests.
    pub moisture: Vec<f32>,
}

/// Decrease of the temperature in degrees Celsius for each metre of height.
pub(crate) const LAPSE_C: f32 = 0.0065;

/// The temperature at sea level in degrees Celsius below which the sea is ice.
pub(crate) const FROZEN_C: f32 = -10.0;

impl Climate {
    /// Returns the mean temperature at sea level in degrees Celsius at a sine of the latitude without its sign.
    pub fn mean_c(&self, sin: f32) -> f32 {
        let warmth = 1.0 - sin * sin * (0.35 + 0.65 * sin * sin);
        self.pole_c + (self.equator_c - self.pole_c) * warmth
    }

    /// Computes the weather of a row. `windward` is the ground of the points some way against the wind: high mountains there
    /// keep the rain away.
    pub fn row(&self, seed: u64, points: &Points, ground: &Ground, windward: &Ground, out: &mut Weather) {
        let n = points.len();
        for buffer in [&mut out.sea_level_c, &mut out.moisture] {
            buffer.clear();
            buffer.resize(n, 0.0);
        }
        add_octaves(points, 1_900_000.0, 5, 0.55, 1.0, part_seed(seed, 80), &mut out.moisture);
        let sin = points.sin_latitude.abs() as f32;
        let mean_c = self.mean_c(sin);
        // The belts of the earth: rain at the equator, deserts at 25 degrees, rain at 55, dry poles.
        let belts = 0.62 - 0.5 * bump(sin, 0.42, 0.26) + 0.22 * bump(sin, 0.0, 0.2) - 0.3 * smooth(0.85, 1.0, sin);
        for k in 0..n {
            let variation = out.moisture[k];
            out.sea_level_c[k] = mean_c + 7.0 * variation;
            let coast = 0.22 * (1.0 - smooth(0.0, 0.5, ground.inland[k]));
            let shadow = 0.35 * windward.mountain[k] * (1.0 - ground.mountain[k]);
            let rain = 0.2 * ground.mountain[k];
            out.moisture[k] = (belts + self.wet + coast + rain - shadow + 0.55 * variation).clamp(0.0, 1.2);
        }
    }
}

/// Returns a smooth bump of height 1 around `middle`, 0 beyond `width`.
fn bump(x: f32, middle: f32, width: f32) -> f32 {
    let t = ((x - middle) / width).clamp(-1.0, 1.0);
    let s = 1.0 - t * t;
    s * s
}

/// The step against the wind along the equator in metres: the wind blows from the west.
pub(crate) const WINDWARD_M: f64 = -250_000.0;
