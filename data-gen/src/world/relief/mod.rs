//! The heights of a world along a row of points: continents, ranges of eroded mountains, hills, layers of rock,
//! craters, the valleys of rivers and glaciers, mesas, and dunes.
//!
//! Each height is a function of the seed and the position. Parts whose mask is 0 along a whole row are left out, which does
//! not change the bits: they would add 0.

mod barchans;
mod coasts;
mod covers;
mod craters;
mod drainage;
mod dunes;
mod lattice;
mod mesas;
mod mountains;
mod noise;
mod rivers;
mod strata;
mod waves;

pub(super) use covers::Covers;
pub(super) use drainage::{Basin, Drainage, Network};
pub(super) use lattice::{LANES, for_blocks, part, wide};
use noise::Vectors;
pub(super) use noise::add_noise;
use rivers::Effects;
pub(super) use rivers::bent;
pub(super) use strata::Layer;

use super::points::Points;
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
    /// Height of the surface above the floor of gullies or above the foot of dunes, about -1..1.
    pub ridge: Vec<f32>,
    /// Share of sand or of glaciers, 0..1.
    pub cover: Vec<f32>,
    /// Height of the ground, or of the water where there is some.
    pub surface_m: Vec<f32>,
    /// Depth of the sea and of lakes in metres, at least -30: below 0 on land.
    pub depth_m: Vec<f32>,
    /// Distance from the bank of the nearest river in metres, below 0 in it, at most [`FAR_M`].
    pub stream_m: Vec<f32>,
    /// The height in metres by which layers of rock lie lower here than elsewhere.
    pub dip_m: Vec<f32>,
    /// The way in metres by which courses of rivers are bent here.
    pub bend_m: Vectors,
}

/// The distance from rivers beyond which it does not matter.
pub(super) const FAR_M: f32 = 1_500.0;

/// The slope of loose sand and stones: the tangent of 32 degrees.
const REPOSE: f32 = 0.62;

/// Buffers for the evaluation of one row. They are kept between rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    noise: Vec<f32>,
    other: Vec<f32>,
    detail: Vec<f32>,
    slope: Vec<f32>,
    strength: Vec<f32>,
    /// The thickness of sand: below 0 there are at most single dunes, at 0.5 sand covers everything.
    sand: Vec<f32>,
    /// The heights in metres by which layers of rock lie lower here than elsewhere, and by how much they are harder.
    dip: Vec<f32>,
    hard: Vec<f32>,
    gradient: Vectors,
    total: Vectors,
    across: Vectors,
    effects: Effects,
}

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
    let (mut frequency, mut amplitude) = (points.radius_m / wavelength_m, amplitude);
    for octave in 0..octaves {
        add_noise(points, frequency, seed.wrapping_add(octave.wrapping_mul(0x3c6e_f372)), amplitude, out);
        frequency *= 2.03;
        amplitude *= gain;
    }
}

impl Relief {
    /// Computes the ground of a row.
    pub fn row(
        &self,
        basin: Basin<'_>,
        points: &Points,
        network: &mut Network,
        scratch: &mut Scratch,
        out: &mut Ground,
    ) {
        self.add_rock(basin.seed, points, scratch, out);
        self.add_rivers(basin, points, network, scratch, out);
        self.add_mesas(basin.seed, points, scratch, out);
        self.add_dunes(basin.seed, points, scratch, out);
    }

    /// Computes the ground of a row without rivers.
    pub fn dry_row(&self, seed: u64, points: &Points, scratch: &mut Scratch, out: &mut Ground) {
        self.add_rock(seed, points, scratch, out);
        self.add_mesas(seed, points, scratch, out);
        self.add_dunes(seed, points, scratch, out);
    }

    /// Computes the ground of a row before rivers cut it and sand covers it.
    fn add_rock(&self, seed: u64, points: &Points, scratch: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        self.add_continents(seed, points, 8, scratch, out);
        self.add_mountains(seed, points, true, scratch, out);
        self.add_sand(seed, points, scratch, out);
        self.set_strata(seed, points, scratch);
        for (k, bed) in out.bed_m.iter_mut().enumerate() {
            *bed = self.stepped(*bed, scratch, k);
        }
        out.dip_m.clear();
        out.dip_m.extend_from_slice(&scratch.dip);
        self.add_craters(seed, points, out);
        self.add_reefs(seed, points, scratch, out);
        // Small bumps; they are higher on mountains.
        reset(&mut scratch.noise, n);
        add_octaves(points, 120.0, 9, 0.5, self.forms.rough_m, part_seed(seed, 3), &mut scratch.noise);
        for k in 0..n {
            let smoothness = 1.0 - 0.9 * smooth(-0.1, 0.2, scratch.sand[k]);
            scratch.noise[k] *= smoothness * (1.0 + 5.0 * out.mountain[k]);
            out.bed_m[k] += scratch.noise[k];
        }
        for k in 0..n {
            let sea_m = if self.has_sea { 0.0 } else { f32::MIN };
            out.surface_m.push(out.bed_m[k].max(sea_m));
            out.depth_m.push((sea_m - out.bed_m[k]).max(-30.0));
        }
    }

    /// Computes the ground that rivers follow, without its small parts, lowered by the depth of valleys. Points need not lie
    /// in a row.
    fn valley_row(&self, seed: u64, points: &Points, scratch: &mut Scratch, out: &mut Ground) {
        self.add_continents(seed, points, 4, scratch, out);
        self.add_mountains(seed, points, false, scratch, out);
        for (k, bed) in out.bed_m.iter_mut().enumerate() {
            let high = if out.mountain[k] > 0.0 { smooth(0.0, 0.2, scratch.detail[k]) } else { 0.0 };
            *bed -= self.rivers.incision_m * (self.rivers.in_plains + (1.0 - self.rivers.in_plains) * high);
        }
    }

    /// Starts with continents and the first octaves of hills, which also make the coast fractal.
    fn add_continents(&self, seed: u64, points: &Points, octaves: u32, scratch: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        for buffer in [&mut out.bed_m, &mut out.inland, &mut out.mountain, &mut out.ridge, &mut out.cover] {
            reset(buffer, n);
        }
        out.surface_m.clear();
        out.depth_m.clear();
        out.stream_m.clear();
        out.stream_m.resize(n, FAR_M);
        out.bend_m.reset(n);
        add_octaves(points, self.continent_m, 7, 0.52, 0.62, part_seed(seed, 1), &mut out.inland);
        out.inland.iter_mut().for_each(|c| *c += self.land);
        reset(&mut scratch.detail, n);
        add_octaves(points, 36_000.0, octaves, 0.46, 1.0, part_seed(seed, 2), &mut scratch.detail);
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
    }
}
