//! A piece of a world as a grid of samples, which are a tile's vertices, and the colours of its texels.
//!
//! Climate and the long waves of the colours' variation are computed at every fourth sample and interpolated.

use super::super::points::{Points, meridians, sin_cos};
use super::super::preset::Flow;
use super::super::relief::{Covers, Ground, add_noise, add_octaves, bent, part_seed, smooth, wide};
use super::climate::{FROZEN_C, LAPSE_C, Weather};
use super::colors::{Texels, wetness, wood};
use super::lumps::Details;
use super::patch_lattice::{Lattice, MARGIN};
use super::planet::{RowBuffers, World};
use crate::pyramid::QUANTUM_M;

/// The number of texels along a cell.
pub(crate) const TEXELS_PER_CELL: usize = 4;
/// The distance between the samples of the climate, in cells.
const COARSE: usize = 4;
/// The wavelength of the coarsest variation of colours in metres; each octave is a quarter as long.
const VARIATION_M: f64 = 160_000.0;
/// The number of octaves of the variation.
const VARIATIONS: u32 = 13;

/// The ground of a place where a tree or a rock may stand.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Site {
    pub surface_m: f32,
    pub slope: f32,
    pub celsius: f32,
    /// Shares of forest and of ground without trees and ice.
    pub wood: f32,
    pub bare: f32,
    /// The share of grass and herbs.
    pub green: f32,
    pub is_dry: bool,
}

/// The samples of a patch, rows from south to north.
pub(crate) struct Patch {
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
            add_noise(points, points.radius_m / wavelength_m, seed.wrapping_add(octave), amplitude, out);
        }
        wavelength_m *= 0.25;
    }
}

/// Rounds a height to the quantum of height tiles.
pub(crate) fn rounded(height_m: f32) -> f32 {
    ((f64::from(height_m) / QUANTUM_M).round() * QUANTUM_M) as f32
}

impl Patch {
    /// Computes the heights of a patch of `cells` cells along a side, a multiple of 4.
    pub fn new(world: &World, lattice: Lattice, cells: usize, buffers: &mut RowBuffers) -> Self {
        let stride = cells + 1 + 2 * MARGIN;
        let meridians = meridians((0..stride as i64).map(|k| lattice.longitude(k - MARGIN as i64)));
        let mut samples = Texels::default();
        for row in 0..stride {
            let latitude = lattice.latitude(row as i64 - MARGIN as i64);
            world.ground_row_of(&meridians, latitude, lattice.step_m(), buffers);
            let ground = &buffers.ground;
            samples.surface_m.extend_from_slice(&ground.surface_m);
            samples.depth_m.extend_from_slice(&ground.depth_m);
            samples.stream_m.extend_from_slice(&ground.stream_m);
            let bend_m = [&ground.bend_m.x, &ground.bend_m.y, &ground.bend_m.z];
            samples.marks.iter_mut().zip(bend_m).for_each(|(mark, bend_m)| mark.extend_from_slice(bend_m));
            samples.inland.extend_from_slice(&ground.inland);
            samples.mountain.extend_from_slice(&ground.mountain);
            samples.ridge.extend_from_slice(&ground.ridge);
            samples.dip_m.extend_from_slice(&ground.dip_m);
            samples.cover.extend_from_slice(&ground.cover);
        }
        Self { stride, samples, lattice }
    }

    /// Returns the surface at a sample relative to the first one inside the margin.
    pub fn surface_m(&self, column: i64, row: i64) -> f32 {
        self.samples.surface_m[(row + MARGIN as i64) as usize * self.stride + (column + MARGIN as i64) as usize]
    }

    pub fn lattice(&self) -> Lattice {
        self.lattice
    }

    /// Returns the share of open water in each cell inside of the margin, 0 to 255, northern row first. The colours were
    /// painted before.
    pub fn water(&self, world: &World) -> Vec<u8> {
        let s = &self.samples;
        let is_wet = world.has_water();
        let water = |at: usize| {
            let is_frozen = s.sea_level_c[at] + 2.0 * s.patch[at] < FROZEN_C;
            if is_wet && !is_frozen { smooth(-0.15, 0.15, s.depth_m[at]) } else { 0.0 }
        };
        let cells = self.stride - 1 - 2 * MARGIN;
        let corners = [0, 1, self.stride, self.stride + 1];
        let share = |row: usize, column: usize| {
            let at = (row + MARGIN) * self.stride + column + MARGIN;
            (255.0 * 0.25 * corners.map(|corner| water(at + corner)).iter().sum::<f32>()).round() as u8
        };
        (0..cells).rev().flat_map(|row| (0..cells).map(move |column| share(row, column))).collect()
    }

    /// Returns the ground at a place between samples, `x` and `y` cells from the first one inside the margin, on the
    /// triangles that are drawn. The colours were painted before.
    pub fn site(&self, world: &World, x: f64, y: f64) -> Site {
        let (column, row) = (x.floor() as i64, y.floor() as i64);
        let (u, v) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
        let corner = |i: i64, j: i64| rounded(self.surface_m(column + i, row + j));
        let (south_west, north_east) = (corner(0, 0), corner(1, 1));
        let surface_m = match u >= v {
            true => south_west + u * (corner(1, 0) - south_west) + v * (north_east - corner(1, 0)),
            false => south_west + v * (corner(0, 1) - south_west) + u * (north_east - corner(0, 1)),
        };
        let nearest = |t: f32| i64::from(t >= 0.5) + MARGIN as i64;
        let at = (row + nearest(v)) as usize * self.stride + (column + nearest(u)) as usize;
        let s = &self.samples;
        let celsius = s.sea_level_c[at] - LAPSE_C * surface_m.max(0.0);
        let living = if world.parameters.climate.has_life { 1.0 } else { 0.0 };
        let wet = wetness(s.moisture[at], s.patch[at], s.open[at], s.ridge[at], s.stream_m[at]);
        let wood = wood(living, celsius, wet, s.slope[at], s.patch[at], 0.0);
        let all_dry = (0..=1).flat_map(|j| (0..=1).map(move |i| (i, j))).all(|(i, j)| {
            let at = (row + j + MARGIN as i64) as usize * self.stride + (column + i) as usize + MARGIN;
            s.depth_m[at] < -0.3 && s.stream_m[at] > 1.0
        });
        let glaciers = if world.parameters.relief.rivers.flow == Flow::Ice { s.cover[at] } else { 0.0 };
        let bare = (1.0 - wood) * (1.0 - glaciers);
        let green = living * bare * smooth(0.22, 0.5, wet) * smooth(-1.0, 4.0, celsius) * smooth(0.8, 0.5, s.slope[at]);
        Site { surface_m, slope: s.slope[at], celsius, wood, bare, green, is_dry: all_dry }
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
            let east_m = (lattice.side[0] / lattice.steps * lattice.radius_m * cos) as f32;
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
        let (meridians_here, meridians_windward) = (meridians(columns()), world.windward(columns()));
        let mut points = Points::on(lattice.radius_m);
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

    /// Replaces the bends of a row of texels by what rivers and glaciers cover of them.
    fn cover_rivers(&self, world: &World, buffers: &RowBuffers, points: &Points, texel_m: f32, texels: &mut Texels) {
        // Rivers are too narrow for large texels.
        let basin = world.basin();
        let near_m = 1.5 * TEXELS_PER_CELL as f32 * texel_m + 50.0;
        let is_fine = f64::from(near_m) < 0.4 * basin.drainage.spacing_m();
        let mut waters = None;
        let [x, y, z] = &mut texels.marks;
        for (k, stream_m) in texels.stream_m.iter().enumerate() {
            let mut covers = Covers::default();
            if *stream_m < near_m && is_fine {
                let cell = basin.drainage.cell(points.longitudes[k], points.latitude);
                if waters.as_ref().is_none_or(|(last, _)| *last != cell) {
                    waters = buffers.network.waters(cell).map(|found| (cell, found)).or(waters);
                }
                let at = bent(points.radius_m, points.at(k), [x[k], y[k], z[k]]);
                covers = match &waters {
                    Some((_, waters)) if basin.relief.rivers.flow == Flow::Ice => waters.glacier_covers(at, texel_m),
                    Some((_, waters)) => waters.river_covers(at, texel_m),
                    None => covers,
                };
            }
            (x[k], y[k], z[k]) = (covers.water, covers.moraine, covers.crevasse);
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
        let mut points = Points::on(lattice.radius_m);
        let mut details = Details::default();
        let seed = part_seed(world.seed, 90);
        let texel_m = lattice.step_m() / TEXELS_PER_CELL as f64;
        self.samples.grain.resize(stride * stride, 0.0);
        let mut rgb = Vec::with_capacity(3 * side * side);
        let share = |k: usize| ((2 * (k % TEXELS_PER_CELL) + 1) as f32) / scale as f32;
        let shares: [f32; TEXELS_PER_CELL] = std::array::from_fn(share);
        for row in (0..side).rev() {
            let (first, t) = (row / TEXELS_PER_CELL + MARGIN, share(row));
            for (samples, out) in self.samples.all().into_iter().zip(texels.all()) {
                let (low, high) = samples[first * stride..(first + 2) * stride].split_at(stride);
                wide(
                    #[inline(always)]
                    || {
                        for ((l, low), high) in line.iter_mut().zip(low).zip(high) {
                            *l = low + (high - low) * t;
                        }
                        let (ends, next) = (&line[MARGIN..], &line[MARGIN + 1..]);
                        for ((texels, end), next) in
                            out.as_chunks_mut::<TEXELS_PER_CELL>().0.iter_mut().zip(ends).zip(next)
                        {
                            for (texel, share) in texels.iter_mut().zip(shares) {
                                *texel = end + (next - end) * share;
                            }
                        }
                    },
                );
            }
            points.set_row(&columns, fine.latitude(2 * row as i64 + 1));
            add_variation(&points, seed, 2.0 * texel_m..8.0 * texel_m, 0.7, &mut texels.grain);
            add_octaves(&points, 3.0 * texel_m, 1, 0.5, 0.35, seed.wrapping_add(77), &mut texels.grain);
            self.cover_rivers(world, buffers, &points, texel_m as f32, &mut texels);
            details.set_row(world.seed, &points, texel_m);
            world.parameters.color(&texels, &details, texel_m as f32, &mut colors);
            let [red, green, blue] = &colors;
            for k in 0..side {
                let byte = |c: f32| (c + 0.5) as u8;
                rgb.extend_from_slice(&[byte(red[k]), byte(green[k]), byte(blue[k])]);
            }
        }
        rgb
    }
}
