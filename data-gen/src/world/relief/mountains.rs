//! Ranges of mountains, with crests and gullies.

use super::super::points::Points;
use super::super::preset::Relief;
use super::noise::{add_noise, noise_gradient};
use super::waves::stripes;
use super::{Ground, Scratch, add_octaves, part_seed, reset, smooth, smooth_max};

/// Half the width of crests, as a value of the noise that makes them.
const CREST: f32 = 0.04;
/// The number of octaves of mountains whose slope gullies follow.
const DIRECTING: u32 = 2;

impl Relief {
    /// Computes only where mountains are.
    pub fn mountain_row(&self, seed: u64, points: &Points, scratch: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        reset(&mut out.inland, n);
        reset(&mut out.mountain, n);
        out.inland.iter_mut().for_each(|c| *c = 1.0);
        self.add_ranges(seed, points, &mut scratch.noise, out);
    }

    /// Computes the mask of mountains: ranges lie along the lines where a noise changes its sign, as along the borders of
    /// plates. Returns false if there are none.
    fn add_ranges(&self, seed: u64, points: &Points, noise: &mut Vec<f32>, out: &mut Ground) -> bool {
        if self.range_width <= 0.0 {
            return false;
        }
        let n = points.len();
        reset(noise, n);
        add_octaves(points, self.range_m, 4, 0.45, 1.0, part_seed(seed, 4), noise);
        let mut highest = 0.0f32;
        for (k, value) in noise.iter().enumerate() {
            let on_land = if self.has_sea { smooth(-0.02, 0.14, out.inland[k]) } else { 1.0 };
            let near = 1.0 - smooth(0.1 * self.range_width, self.range_width, value.abs());
            out.mountain[k] = near * on_land;
            highest = highest.max(out.mountain[k]);
        }
        highest > 0.0
    }

    /// Adds ranges of mountains with gullies that follow the slope.
    pub(super) fn add_mountains(
        &self,
        seed: u64,
        points: &Points,
        gullies: bool,
        scratch: &mut Scratch,
        out: &mut Ground,
    ) {
        let n = points.len();
        let s = scratch;
        if !self.add_ranges(seed, points, &mut s.noise, out) {
            return;
        }
        // Large mountains: each octave is damped where the ones before it are steep.
        reset(&mut s.other, n);
        reset(&mut s.noise, n);
        for v in [&mut s.gradient, &mut s.total] {
            v.reset(n);
        }
        reset(&mut s.strength, n);
        s.strength.fill(1.0);
        reset(&mut s.slope, n);
        let (mut wavelength_m, mut amplitude) = (self.massif_m, 1.0f32);
        for octave in 0..4 {
            let frequency = points.radius_m / wavelength_m;
            noise_gradient(points, frequency, part_seed(seed, 10 + octave), &mut s.noise, &mut s.gradient);
            // Metres of height for each metre of distance, if amplitudes are heights.
            let rise = amplitude * self.mountain_m / wavelength_m as f32;
            for k in 0..n {
                // Both sides of a crest have one damping: one that ends on the crest would leave a wall there.
                let damping = 1.0 / (1.0 + 1.5 * s.slope[k]);
                // Crests lie where the noise changes its sign. They are round, so that gullies continue across them.
                let from_crest = (s.noise[k] * s.noise[k] + CREST * CREST).sqrt();
                s.other[k] += amplitude * damping * (0.64 - 1.9 * from_crest);
                let side = 1.9 * rise * damping;
                let [gx, gy, gz] = s.gradient.at(k);
                s.slope[k] += side * side * (gx * gx + gy * gy + gz * gz);
                // Gullies follow the slope of the largest mountains, and end before their crests, where the slope turns
                // around: those of both sides would meet there like teeth.
                if octave < DIRECTING {
                    s.strength[k] *= smooth(0.01, 0.12, s.noise[k].abs());
                    let rise = -side * s.noise[k] / from_crest;
                    s.total.x[k] += rise * gx;
                    s.total.y[k] += rise * gy;
                    s.total.z[k] += rise * gz;
                }
            }
            wavelength_m *= 0.47;
            amplitude *= 0.5;
        }
        for k in 0..n {
            let m = out.mountain[k];
            // Valleys are filled by sediment.
            let floor = 0.05;
            s.detail[k] = m * (smooth_max(s.other[k] * (0.3 + 0.7 * m), floor, 0.07) - floor);
        }
        if gullies {
            self.add_gullies(seed, points, s, out);
            self.add_crags(seed, points, s);
            self.add_cliffs(seed, points, s);
        }
        for k in 0..n {
            // The floors of valleys are flat. A detail of 0 adds exactly 0, as rows without mountains do.
            out.bed_m[k] += self.mountain_m * (smooth_max(s.detail[k], 0.0, 0.02) - 0.005);
        }
    }

    /// Adds rocks to steep slopes and to crests in `scratch.detail`.
    fn add_crags(&self, seed: u64, points: &Points, s: &mut Scratch) {
        reset(&mut s.strength, points.len());
        for (strength, detail) in s.strength.iter_mut().zip(&s.detail) {
            *strength = smooth(0.05, 0.4, *detail);
        }
        let (mut wavelength_m, mut amplitude) = (0.06 * self.massif_m, 0.034f32);
        for octave in 0..3 {
            reset(&mut s.noise, points.len());
            let part = part_seed(seed, 26 + octave);
            add_noise(points, points.radius_m / wavelength_m, part, 1.0, &mut s.noise);
            for ((detail, strength), noise) in s.detail.iter_mut().zip(&s.strength).zip(&s.noise) {
                *detail += amplitude * strength * (0.35 - noise.abs());
            }
            wavelength_m *= 0.45;
            amplitude *= 0.5;
        }
    }

    /// Adds gullies to `scratch.detail`, where `scratch.strength` is above 0. Their direction follows the slope of
    /// `scratch.total` and of the larger gullies.
    fn add_gullies(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        s.across.reset(n);
        reset(&mut s.slope, n);
        for k in 0..n {
            let (x, y, z) = (s.total.x[k], s.total.y[k], s.total.z[k]);
            s.strength[k] *= smooth(0.0, 0.25, x * x + y * y + z * z) * smooth(0.0, 0.06, s.detail[k]);
        }
        let (mut wavelength_m, mut amplitude) = (0.14 * self.massif_m, self.gullies);
        for octave in 0..5 {
            for k in 0..n {
                let (x, y, z) = (points.x[k] as f32, points.y[k] as f32, points.z[k] as f32);
                let (gx, gy, gz) = (s.total.x[k], s.total.y[k], s.total.z[k]);
                // The slope turned by a quarter around the vertical. Gullies are closer together where it is steep.
                let (ax, ay, az) = (y * gz - z * gy, z * gx - x * gz, x * gy - y * gx);
                let steep = (ax * ax + ay * ay + az * az).sqrt();
                let turns = 1.25 / (0.12 + steep);
                (s.across.x[k], s.across.y[k], s.across.z[k]) = (ax * turns, ay * turns, az * turns);
            }
            stripes(
                points,
                points.radius_m / wavelength_m,
                part_seed(seed, 20 + octave),
                &s.across,
                &mut s.noise,
                &mut s.slope,
            );
            // Smaller gullies turn towards larger ones.
            let rise = 0.25 * amplitude * self.mountain_m / wavelength_m as f32;
            for k in 0..n {
                let (ax, ay, az) = (s.across.x[k], s.across.y[k], s.across.z[k]);
                let strength = s.strength[k] * smooth(0.05, 0.5, out.mountain[k]);
                s.detail[k] += amplitude * strength * 0.5 * s.noise[k];
                out.ridge[k] += amplitude / self.gullies * 0.5 * strength * s.noise[k];
                let rise = rise * strength * s.slope[k];
                s.total.x[k] += rise * ax;
                s.total.y[k] += rise * ay;
                s.total.z[k] += rise * az;
            }
            wavelength_m *= 0.5;
            amplitude *= 0.47;
        }
    }
}
