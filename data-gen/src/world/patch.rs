//! A piece of a world as a grid of samples, which are a tile's vertices, and the colours of its texels.
//!
//! Climate and the long waves of the colours' variation are computed at every fourth sample and interpolated.

use super::climate::Weather;
use super::colors::Texels;
use super::noise::add_noise;
use super::planet::{RowBuffers, World, meridians, windward};
use super::points::{Points, RADIUS_M, sin_cos};
use super::relief::{Ground, add_octaves, part_seed};

/// Samples beyond each edge, for slopes and the shade of surroundings.
pub(super) const MARGIN: usize = 4;
/// The number of texels along a cell.
pub(super) const TEXELS_PER_CELL: usize = 4;
/// The distance between the samples of the climate, in cells.
const COARSE: usize = 4;
/// The wavelength of the coarsest variation of colours in metres; each octave is a quarter as long.
const VARIATION_M: f64 = 160_000.0;
/// The number of octaves of the variation.
const VARIATIONS: u32 = 10;

/// The rectangle of a patch: its cells are `step` radians of longitude and latitude, the first sample inside is at
/// `(column, row)` steps from the origin. Positions are computed from whole numbers, so that they have the same bits in all
/// patches.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    pub origin: [f64; 2],
    pub side: [f64; 2],
    /// The number of steps along the whole side.
    pub steps: f64,
    pub column: i64,
    pub row: i64,
}

impl Lattice {
    pub fn longitude(&self, column: i64) -> f64 {
        self.origin[0] + self.side[0] * ((self.column + column) as f64 / self.steps)
    }

    pub fn latitude(&self, row: i64) -> f64 {
        self.origin[1] + self.side[1] * ((self.row + row) as f64 / self.steps)
    }

    /// Returns the distance between rows in metres.
    pub fn step_m(&self) -> f64 {
        self.side[1] / self.steps * RADIUS_M
    }
}

/// The samples of a patch, rows from south to north.
pub(super) struct Patch {
    /// Samples along a side, the margins included.
    stride: usize,
    samples: Texels,
    lattice: Lattice,
}

/// Adds the octaves of the variation of colours whose wavelengths lie in a range in metres.
fn add_variation(points: &Points, seed: u32, range_m: std::ops::Range<f64>, amplitude: f32, out: &mut [f32]) {
    let mut wavelength_m = VARIATION_M;
    for octave in 0..VARIATIONS {
        if range_m.contains(&wavelength_m) {
            add_noise(points, RADIUS_M / wavelength_m, seed.wrapping_add(octave), amplitude, out);
        }
        wavelength_m *= 0.25;
    }
}

impl Patch {
    /// Computes the heights of a patch of `cells` cells along a side, a multiple of 4.
    pub fn new(world: &World, lattice: Lattice, cells: usize, buffers: &mut RowBuffers) -> Self {
        let stride = cells + 1 + 2 * MARGIN;
        let meridians = meridians((0..stride as i64).map(|k| lattice.longitude(k - MARGIN as i64)));
        let mut samples = Texels::default();
        let water_m = world.water_m();
        for row in 0..stride {
            world.ground_row(&meridians, lattice.latitude(row as i64 - MARGIN as i64), buffers);
            let ground = &buffers.ground;
            samples.surface_m.extend(ground.bed_m.iter().map(|bed| bed.max(water_m)));
            samples.depth_m.extend(ground.bed_m.iter().map(|bed| water_m - bed));
            samples.inland.extend_from_slice(&ground.inland);
            samples.mountain.extend_from_slice(&ground.mountain);
            samples.ridge.extend_from_slice(&ground.ridge);
            samples.cover.extend_from_slice(&ground.cover);
        }
        Self { stride, samples, lattice }
    }

    /// Returns the surface at a sample relative to the first one inside the margin.
    pub fn surface_m(&self, column: i64, row: i64) -> f32 {
        self.samples.surface_m[(row + MARGIN as i64) as usize * self.stride + (column + MARGIN as i64) as usize]
    }

    /// Computes the slopes, and how far points lie above their surroundings.
    fn add_slopes(&mut self) {
        let (stride, lattice) = (self.stride, self.lattice);
        self.samples.slope.resize(stride * stride, 0.0);
        self.samples.open.resize(stride * stride, 0.0);
        let north_m = lattice.step_m() as f32;
        let h = &self.samples.surface_m;
        for row in MARGIN - 1..stride - MARGIN + 1 {
            let latitude = lattice.latitude(row as i64 - MARGIN as i64);
            let cos = sin_cos(latitude).1.max(0.02);
            let east_m = (lattice.side[0] / lattice.steps * RADIUS_M * cos) as f32;
            let (per_east, per_north) = (0.5 / east_m, 0.5 / north_m);
            let far = MARGIN - 1;
            let per_open = [1.0 / north_m, 1.0 / (far as f32 * north_m)];
            for column in MARGIN - 1..stride - MARGIN + 1 {
                let at = row * stride + column;
                let east = (h[at + 1] - h[at - 1]) * per_east;
                let north = (h[at + stride] - h[at - stride]) * per_north;
                self.samples.slope[at] = (east * east + north * north).sqrt();
                let around = |d: usize| 0.25 * (h[at + d] + h[at - d] + h[at + d * stride] + h[at - d * stride]);
                self.samples.open[at] = 0.6 * (h[at] - around(1)) * per_open[0] + (h[at] - around(far)) * per_open[1];
            }
        }
    }

    /// Computes climate and variation: the long waves at every fourth sample.
    fn add_climate(&mut self, world: &World, buffers: &mut RowBuffers) {
        let (stride, lattice) = (self.stride, self.lattice);
        let seed = part_seed(world.seed, 90);
        let cell_m = lattice.step_m();
        let coarse = stride.div_ceil(COARSE);
        let columns = || (0..coarse as i64).map(|k| lattice.longitude(k * COARSE as i64 - MARGIN as i64));
        let (meridians_here, meridians_windward) = (meridians(columns()), windward(columns()));
        let mut points = Points::default();
        let mut ground = Ground::default();
        let mut weather = Weather::default();
        let mut fields: [Vec<f32>; 3] = Default::default();
        for row in 0..coarse {
            let latitude = lattice.latitude((row * COARSE) as i64 - MARGIN as i64);
            points.set_row(&meridians_here, latitude);
            let start = row * COARSE * stride;
            let every = |from: &[f32]| from[start..start + stride].iter().copied().step_by(COARSE).collect();
            (ground.inland, ground.mountain) = (every(&self.samples.inland), every(&self.samples.mountain));
            world.weather_row(&points, &meridians_windward, latitude, &ground, buffers, &mut weather);
            fields[0].extend_from_slice(&weather.sea_level_c);
            fields[1].extend_from_slice(&weather.moisture);
            fields[2].resize((row + 1) * coarse, 0.0);
            add_variation(&points, seed, 12.0 * cell_m..f64::MAX, 0.35, &mut fields[2][row * coarse..]);
        }
        let samples = &mut self.samples;
        for (field, out) in fields.iter().zip([&mut samples.sea_level_c, &mut samples.moisture, &mut samples.patch]) {
            out.clear();
            for row in 0..stride {
                let (low, v) = (row / COARSE, (row % COARSE) as f32 / COARSE as f32);
                let high = (low + 1).min(coarse - 1);
                out.extend((0..stride).map(|column| {
                    let (left, u) = (column / COARSE, (column % COARSE) as f32 / COARSE as f32);
                    let right = (left + 1).min(coarse - 1);
                    let at = |row: usize| {
                        let (a, b) = (field[row * coarse + left], field[row * coarse + right]);
                        a + (b - a) * u
                    };
                    at(low) + (at(high) - at(low)) * v
                }));
            }
        }
        let all = meridians((0..stride as i64).map(|k| lattice.longitude(k - MARGIN as i64)));
        for (row, out) in samples.patch.chunks_exact_mut(stride).enumerate() {
            points.set_row(&all, lattice.latitude(row as i64 - MARGIN as i64));
            add_variation(&points, seed, 2.0 * cell_m..12.0 * cell_m, 0.35, out);
        }
    }

    /// Paints the texels as RGB, north row first. A texel's colour depends on the position and the size of cells only.
    pub fn paint(&mut self, world: &World, buffers: &mut RowBuffers) -> Vec<u8> {
        self.add_slopes();
        self.add_climate(world, buffers);
        let stride = self.stride;
        let side = TEXELS_PER_CELL * (stride - 1 - 2 * MARGIN);
        let lattice = self.lattice;
        // The centres of texels are odd numbers of steps of this lattice.
        let scale = 2 * TEXELS_PER_CELL as i64;
        let fine = Lattice {
            steps: scale as f64 * lattice.steps,
            column: scale * lattice.column,
            row: scale * lattice.row,
            ..lattice
        };
        let columns = meridians((0..side as i64).map(|k| fine.longitude(2 * k + 1)));
        let mut texels = Texels::default();
        texels.all().into_iter().for_each(|buffer| buffer.resize(side, 0.0));
        let mut line = vec![0.0f32; stride];
        let mut colors: [Vec<f32>; 3] = Default::default();
        let mut points = Points::default();
        let seed = part_seed(world.seed, 90);
        let texel_m = lattice.step_m() / TEXELS_PER_CELL as f64;
        self.samples.grain.resize(stride * stride, 0.0);
        let mut rgb = Vec::with_capacity(3 * side * side);
        let share = |k: usize| ((2 * (k % TEXELS_PER_CELL) + 1) as f32) / scale as f32;
        for row in (0..side).rev() {
            let (first, t) = (row / TEXELS_PER_CELL + MARGIN, share(row));
            for (samples, out) in self.samples.all().into_iter().zip(texels.all()) {
                let (low, high) = samples[first * stride..(first + 2) * stride].split_at(stride);
                for ((l, low), high) in line.iter_mut().zip(low).zip(high) {
                    *l = low + (high - low) * t;
                }
                for (texels, ends) in out.chunks_exact_mut(TEXELS_PER_CELL).zip(line[MARGIN..].windows(2)) {
                    for (k, texel) in texels.iter_mut().enumerate() {
                        *texel = ends[0] + (ends[1] - ends[0]) * share(k);
                    }
                }
            }
            points.set_row(&columns, fine.latitude(2 * row as i64 + 1));
            add_variation(&points, seed, 2.0 * texel_m..8.0 * texel_m, 0.7, &mut texels.grain);
            add_octaves(&points, 3.0 * texel_m, 1, 0.5, 0.35, seed.wrapping_add(77), &mut texels.grain);
            world.parameters.color(&texels, &mut colors);
            let [red, green, blue] = &colors;
            for k in 0..side {
                rgb.extend([red[k], green[k], blue[k]].map(|c| (c + 0.5) as u8));
            }
        }
        rgb
    }
}
