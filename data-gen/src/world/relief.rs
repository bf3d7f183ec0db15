//! The heights of a world along a row of points: continents, ranges of eroded mountains, hills, dunes, craters, canyons and
//! glaciers.
//!
//! Each height is a function of the seed and the position. Parts whose mask is 0 along a whole row are left out, which does
//! not change the bits: they would add 0.

use super::noise::{Vectors, add_craters, add_noise, noise_gradient, stripes};
use super::points::{Points, RADIUS_M};
use super::preset::Relief;

/// The ground of a row of points, and what the colours need to know about it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ground {
    /// Height of the ground or of the bed of the sea in metres.
    pub bed_m: Vec<f32>,
    /// Continents: below 0 in the sea, about 0.5 far inland.
    pub inland: Vec<f32>,
    /// Mountains: 0 in plains, 1 in the middle of ranges.
    pub mountain: Vec<f32>,
    /// Height of the surface above the floor of gullies, about -1..1.
    pub ridge: Vec<f32>,
    /// Share of dunes or of glaciers, 0..1.
    pub cover: Vec<f32>,
}

/// Buffers for the evaluation of one row. They are kept between rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    noise: Vec<f32>,
    other: Vec<f32>,
    detail: Vec<f32>,
    slope: Vec<f32>,
    strength: Vec<f32>,
    gradient: Vectors,
    total: Vectors,
    across: Vectors,
}

/// Half the width of crests, as a value of the noise that makes them.
const CREST: f32 = 0.1;

/// Clears a buffer and gives it a length.
fn reset(buffer: &mut Vec<f32>, len: usize) {
    buffer.clear();
    buffer.resize(len, 0.0);
}

/// Returns 0 below `low`, 1 above `high`, and a smooth step between them.
#[inline(always)]
pub(super) fn smooth(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Returns the larger value, blended smoothly where they differ by less than `width`.
#[inline(always)]
fn smooth_max(a: f32, b: f32, width: f32) -> f32 {
    let t = (0.5 + 0.5 * (a - b) / width).clamp(0.0, 1.0);
    b + (a - b) * t + width * t * (1.0 - t)
}

/// Returns the seed of a part of the relief.
pub(super) fn part_seed(seed: u64, part: u32) -> u32 {
    terrane::math::random::mix64(seed ^ (u64::from(part) << 40)) as u32
}

/// Adds octaves of noise from one wavelength down, each half as long and `gain` times as high.
pub(super) fn add_octaves(
    points: &Points,
    wavelength_m: f64,
    octaves: u32,
    gain: f32,
    amplitude: f32,
    seed: u32,
    out: &mut [f32],
) {
    let (mut frequency, mut amplitude) = (RADIUS_M / wavelength_m, amplitude);
    for octave in 0..octaves {
        add_noise(points, frequency, seed.wrapping_add(octave.wrapping_mul(0x3c6e_f372)), amplitude, out);
        frequency *= 2.03;
        amplitude *= gain;
    }
}

impl Relief {
    /// Computes the ground of a row.
    pub fn row(&self, seed: u64, points: &Points, scratch: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        for buffer in [&mut out.bed_m, &mut out.inland, &mut out.mountain, &mut out.ridge, &mut out.cover] {
            reset(buffer, n);
        }
        add_octaves(points, self.continent_m, 7, 0.52, 0.62, part_seed(seed, 1), &mut out.inland);
        out.inland.iter_mut().for_each(|c| *c += self.land);
        // Hills, which also make the coast fractal.
        reset(&mut scratch.detail, n);
        add_octaves(points, 36_000.0, 8, 0.46, 1.0, part_seed(seed, 2), &mut scratch.detail);
        for k in 0..n {
            let (c, hills) = (out.inland[k], scratch.detail[k]);
            // The profile of a continent: deep sea, slope, shelf, coastal plain, interior.
            let shelf = 140.0 * (c * 12.0).clamp(-1.0, 0.0);
            let slope = (self.ocean_m - 140.0) * smooth(0.08, 0.3, -c);
            let interior = self.plain_m * (0.2 * smooth(0.0, 0.06, c) + 0.8 * smooth(0.05, 0.7, c));
            let uneven = self.hill_m * (0.12 + 0.88 * smooth(0.0, 0.35, c.abs()));
            let bed = shelf - slope + interior + uneven * hills;
            // Land does not sink below the sea again inland: there would be dots of sea.
            let dry = 6.0 + 0.3 * uneven * (hills + 0.6).max(0.0);
            let there = if self.has_sea { smooth(0.03, 0.1, c) } else { 0.0 };
            out.bed_m[k] = bed + (smooth_max(bed, dry, 40.0) - bed) * there;
        }
        self.add_mountains(seed, points, scratch, out);
        if self.glacier_m > 0.0 {
            self.fill_valleys(seed, points, scratch, out);
        }
        self.add_canyons(seed, points, scratch, out);
        self.add_dunes(seed, points, scratch, out);
        self.add_craters(seed, points, out);
        // Small bumps; they are higher on mountains.
        reset(&mut scratch.noise, n);
        add_octaves(points, 120.0, 6, 0.5, self.rough_m, part_seed(seed, 3), &mut scratch.noise);
        for k in 0..n {
            let smoothness = 1.0 - 0.85 * out.cover[k];
            out.bed_m[k] += scratch.noise[k] * smoothness * (1.0 + 5.0 * out.mountain[k]);
        }
    }

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
    fn add_mountains(&self, seed: u64, points: &Points, scratch: &mut Scratch, out: &mut Ground) {
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
        let (mut wavelength_m, mut amplitude) = (self.massif_m, 1.0f32);
        for octave in 0..4 {
            let frequency = RADIUS_M / wavelength_m;
            noise_gradient(points, frequency, part_seed(seed, 10 + octave), &mut s.noise, &mut s.gradient);
            // Metres of height for each metre of distance, if amplitudes are heights.
            let rise = amplitude * self.mountain_m / wavelength_m as f32;
            for k in 0..n {
                let steep = s.total.x[k] * s.total.x[k] + s.total.y[k] * s.total.y[k] + s.total.z[k] * s.total.z[k];
                let damping = 1.0 / (1.0 + 1.5 * steep);
                // Crests lie where the noise changes its sign. They are round, so that gullies continue across them.
                let from_crest = (s.noise[k] * s.noise[k] + CREST * CREST).sqrt();
                s.other[k] += amplitude * damping * (0.64 - 1.9 * from_crest);
                // The slope turns around at crests. Gullies in both directions would meet there like teeth.
                if octave < 2 {
                    s.strength[k] *= smooth(0.0, 0.05, s.noise[k].abs());
                }
                let rise = -1.9 * rise * damping * s.noise[k] / from_crest;
                s.total.x[k] += rise * s.gradient.x[k];
                s.total.y[k] += rise * s.gradient.y[k];
                s.total.z[k] += rise * s.gradient.z[k];
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
        self.add_gullies(seed, points, s, out);
        for k in 0..n {
            // The floors of valleys are flat. A detail of 0 adds exactly 0, as rows without mountains do.
            out.bed_m[k] += self.mountain_m * (smooth_max(s.detail[k], 0.0, 0.02) - 0.005);
        }
    }

    /// Adds gullies to `scratch.detail`, where `scratch.strength` is above 0. Their direction follows the slope of `scratch.total` and of the larger gullies.
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
                RADIUS_M / wavelength_m,
                part_seed(seed, 20 + octave),
                &s.across,
                &mut s.noise,
                &mut s.slope,
            );
            let rise = 0.5 * amplitude * self.mountain_m / wavelength_m as f32;
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

    /// Fills the valleys of mountains with glaciers, which descend smoothly and have crevasses.
    fn fill_valleys(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        reset(&mut s.noise, n);
        add_octaves(points, 2.0 * self.massif_m, 3, 0.4, 0.5, part_seed(seed, 30), &mut s.noise);
        reset(&mut s.other, n);
        add_octaves(points, 420.0, 2, 0.5, 1.0, part_seed(seed, 31), &mut s.other);
        for k in 0..n {
            let level = self.plain_m * 0.5 + self.glacier_m * (0.6 + s.noise[k]) * (0.3 + out.mountain[k]);
            let open = 1.0 - smooth(0.0, 0.12, s.other[k].abs());
            let ice = level - 9.0 * open * smooth(0.1, 0.4, out.mountain[k]);
            let rock = out.bed_m[k];
            if out.inland[k] > 0.0 || !self.has_sea {
                let there = smooth(0.0, 0.05, out.inland[k]);
                let filled = smooth_max(rock, ice, 90.0);
                out.cover[k] = there * smooth(-60.0, 60.0, ice - rock);
                out.bed_m[k] = rock + (filled - rock) * there;
            }
        }
    }

    /// Cuts canyons along the lines where noises change their signs, and steps the slopes by layers of rock.
    fn add_canyons(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        if self.canyon_m > 0.0 {
            reset(&mut s.detail, n);
            let (mut wavelength_m, mut depth, mut width) = (70_000.0, 0.62f32, 0.28f32);
            for octave in 0..3 {
                reset(&mut s.noise, n);
                add_octaves(points, wavelength_m, 4, 0.5, 1.0, part_seed(seed, 40 + octave), &mut s.noise);
                for k in 0..n {
                    let v = s.noise[k].abs();
                    let cut = 1.0 - smooth(0.08 * width, width, v);
                    // Side canyons begin where the larger ones have cut.
                    let near = if octave == 0 { 1.0 } else { smooth(0.0, 0.5, s.detail[k]) };
                    s.detail[k] += depth * cut * (0.25 + 0.75 * near);
                }
                wavelength_m *= 0.31;
                depth *= 0.5;
                width *= 1.25;
            }
            reset(&mut s.other, n);
            add_octaves(points, 700_000.0, 2, 0.5, 1.0, part_seed(seed, 45), &mut s.other);
            for k in 0..n {
                let region = smooth(-0.35, 0.1, s.other[k]);
                out.bed_m[k] -= self.canyon_m * region * s.detail[k].min(1.15);
                out.ridge[k] -= region * s.detail[k].min(1.0);
            }
        }
        if self.layer_m > 0.0 {
            for k in 0..n {
                let t = out.bed_m[k] / self.layer_m;
                let floor = (t - 0.5 + 12_582_912.0) - 12_582_912.0;
                let f = t - floor;
                // Two hard layers in each step: slopes, then cliffs.
                let stepped = floor + 0.35 * f + 0.65 * smooth(0.45, 0.8, f);
                out.bed_m[k] += 0.8 * self.layer_m * (stepped - t);
            }
        }
    }

    /// Adds dunes across the wind: long crests with a gentle and a steep side.
    fn add_dunes(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        if self.dune_m <= 0.0 {
            return;
        }
        reset(&mut s.other, n);
        add_octaves(points, 60_000.0, 3, 0.5, 1.0, part_seed(seed, 50), &mut s.other);
        for k in 0..n {
            out.cover[k] = smooth(-0.35, 0.1, s.other[k]) * (1.0 - smooth(0.1, 0.5, out.mountain[k]));
        }
        if out.cover.iter().all(|c| *c == 0.0) {
            return;
        }
        // Crests are long across the wind: the lattice is stretched along one axis.
        let mut stretched = points.clone();
        for k in 0..n {
            let along = 0.6 * points.x[k] - 0.5 * points.y[k] + 0.62 * points.z[k];
            stretched.x[k] -= 0.65 * along * 0.6;
            stretched.y[k] += 0.65 * along * 0.5;
            stretched.z[k] -= 0.65 * along * 0.62;
        }
        let (mut wavelength_m, mut amplitude) = (1_700.0, 1.0f32);
        for octave in 0..3 {
            reset(&mut s.noise, n);
            add_octaves(&stretched, wavelength_m, 2, 0.3, 1.0, part_seed(seed, 51 + octave), &mut s.noise);
            for k in 0..n {
                let crest = 1.0 - s.noise[k].abs().min(1.0);
                let sharp = crest * crest;
                out.bed_m[k] += self.dune_m * amplitude * out.cover[k] * (sharp - 0.4);
            }
            wavelength_m *= 0.23;
            amplitude *= 0.16;
        }
    }

    /// Adds craters of all sizes, small ones on top of large ones.
    fn add_craters(&self, seed: u64, points: &Points, out: &mut Ground) {
        if self.craters <= 0.0 {
            return;
        }
        let (mut cell_m, mut share) = (900_000.0f64, 0.3f32);
        for octave in 0..14 {
            // Large craters are flatter.
            let flat = 1.0 / (1.0 + cell_m as f32 / 60_000.0);
            let depth = self.craters * cell_m as f32 * (0.03 + 0.55 * flat);
            add_craters(points, RADIUS_M / cell_m, part_seed(seed, 60 + octave), share, depth, &mut out.bed_m);
            cell_m *= 0.5;
            share = 0.8;
        }
    }
}
