//! Paints the colour of a tile: from imagery, and elsewhere by height, slope and noise with baked ambient shading.
//!
//! A texel depends on its position in the world only, so the edges of neighbouring tiles agree. The renderer adds
//! sunlight; the baked shading is the share of the sky that is visible from a point.

use rayon::prelude::*;
use terrane::math::{Ellipsoid, MARS, WGS84};

use super::imagery::Imagery;
use crate::body::is_same;
use crate::noise::{add_gradient_row, fbm_row};
use crate::pyramid::{Block, Lattice, Surface, TileKey};
use crate::{Extent, GenError};

/// The number of texels along a tile's side.
pub(crate) const TEXELS: u16 = 256;
const N: usize = TEXELS as usize;

/// Paints the tiles of a block. Threads share one painter.
pub(crate) struct Painter<'a> {
    set: &'a Extent,
    ellipsoid: Ellipsoid,
    imagery: Option<&'a Imagery>,
    /// The heights for each level of the block, root first.
    surfaces: Vec<Surface<'a>>,
    root_level: u32,
    /// About the lowest and the highest height of the set in metres.
    range_m: [f32; 2],
}

impl<'a> Painter<'a> {
    /// Creates the painter of a block of a set with a rectangle. The block was made for painting.
    pub fn new(block: &'a Block<'_>, set: &'a Extent, imagery: Option<&'a Imagery>, range_m: [f32; 2]) -> Self {
        let levels = (block.root.level..=block.layer.finest).into_par_iter();
        let surfaces = levels.map(|level| block.surface(level)).collect();
        let ellipsoid = block.ellipsoid();
        Self { set, ellipsoid, imagery, surfaces, root_level: block.root.level, range_m }
    }

    /// Returns the RGB texels of a tile, north row first.
    pub fn paint(&self, key: TileKey) -> Result<Vec<u8>, GenError> {
        let e = key.extent(self.set);
        let surface = &self.surfaces[(key.level - self.root_level) as usize];
        let mut rgb = Vec::with_capacity(N * N * 3);
        let tiles = f64::from(1u32 << key.level);
        let u = [0.5, N as f64 - 0.5].map(|c| (f64::from(key.x) + c / N as f64) / tiles);
        let mut terrain = TerrainRow::new(surface, self.set, &self.ellipsoid, u);
        let mut colors = [[0.0f32; N]; 3];
        let texel = [e.east - e.west, e.north - e.south].map(|side| side / N as f64);
        let mut imagery = self.imagery.map(|imagery| imagery.sampler(&e, texel));
        for row in 0..N {
            let v = (f64::from(key.y) + 1.0 - (row as f64 + 0.5) / N as f64) / tiles;
            let latitude = e.north - (e.north - e.south) * (row as f64 + 0.5) / N as f64;
            let mut has_terrain = false;
            for column in 0..N {
                let longitude = e.west + (e.east - e.west) * (column as f64 + 0.5) / N as f64;
                let image = imagery.as_mut().map(|imagery| imagery.at(longitude, latitude)).transpose()?.flatten();
                let [r, g, b, opacity] = image.unwrap_or_default().map(|c| c as f32);
                let mut color = [r, g, b];
                if opacity < 1.0 {
                    if !has_terrain {
                        terrain.sample(surface, v);
                        terrain.color(self.range_m, &mut colors);
                        has_terrain = true;
                    }
                    color = [0, 1, 2].map(|k| colors[k][column] + (color[k] - colors[k][column]) * opacity);
                }
                rgb.extend(color.map(|c| (c + 0.5) as u8));
            }
        }
        Ok(rgb)
    }
}

/// The heights, slopes and noise of one row of texels. Each buffer has one value per texel.
struct TerrainRow {
    /// The lattice whose cells are texels.
    fine: LevelRow,
    /// Three coarser ones for the ambient shading.
    coarser: [LevelRow; 3],
    /// The distance from the set's western edge to the first texel, and that between texels, in metres.
    x_m: [f64; 2],
    /// The sides of the set in metres.
    sides_m: [f64; 2],
    /// The distance between samples of the first level in metres, east and north.
    step_m: [f64; 2],
    palette: &'static Palette,
    height: [f32; N],
    east: [f32; N],
    north: [f32; N],
    around: [[f32; N]; 3],
    patch: [f32; N],
    grain: [f32; N],
}

impl TerrainRow {
    /// Creates the row. `u` is the position of the first and the last texel, 0..1 over the set.
    fn new(surface: &Surface<'_>, extent: &Extent, ellipsoid: &Ellipsoid, u: [f64; 2]) -> Self {
        let mean_lat = 0.5 * (extent.south + extent.north);
        // The earth has a radius of 6371 km here, so that the colours of older sets stay the same.
        let radius_m = ellipsoid.semi_major_m * (6_371_000.0 / WGS84.semi_major_m);
        let sides_m =
            [radius_m * mean_lat.cos() * (extent.east - extent.west), radius_m * (extent.north - extent.south)];
        let [fine, coarser @ ..] = surface.lattices();
        let cells = fine.cells as f64;
        Self {
            fine: LevelRow::new(fine, u),
            coarser: coarser.each_ref().map(|lattice| LevelRow::new(lattice, u)),
            x_m: [u[0] * sides_m[0], (u[1] - u[0]) / (N - 1) as f64 * sides_m[0]],
            sides_m,
            step_m: sides_m.map(|m| m / cells),
            palette: match ellipsoid {
                earth if earth.is_earth() => &EARTH,
                mars if is_same(mars, &MARS) => &RED,
                _ => &GREY,
            },
            height: [0.0; N],
            east: [0.0; N],
            north: [0.0; N],
            around: [[0.0; N]; 3],
            patch: [0.0; N],
            grain: [0.0; N],
        }
    }

    /// Computes heights, slopes and noise at the row `v`, 0..1 over the set.
    fn sample(&mut self, surface: &Surface<'_>, v: f64) {
        let [fine, coarser @ ..] = surface.lattices();
        self.fine.slopes(fine, v, &mut self.height, &mut self.east, &mut self.north);
        let per_m = self.step_m.map(|m| (0.5 / m) as f32);
        self.east.iter_mut().for_each(|d| *d *= per_m[0]);
        self.north.iter_mut().for_each(|d| *d *= per_m[1]);
        for ((row, lattice), around) in self.coarser.iter_mut().zip(coarser).zip(&mut self.around) {
            row.heights(lattice, v, around);
        }
        let ([x, step], y) = (self.x_m, v * self.sides_m[1]);
        fbm_row(&mut self.patch, x / 1700.0, step / 1700.0, y / 1700.0, 6, 901);
        self.grain.fill(0.0);
        if step < 35.0 {
            add_gradient_row(&mut self.grain, 1.0, x / 70.0, step / 70.0, y / 70.0, 902);
        }
    }

    /// Computes the sRGB colour, 0..255, of terrain in a temperate climate, or of bare ground. The range is that of the set's heights. The loop has
    /// no branches and separate arrays, so that the compiler can vectorise it.
    fn color(&self, [low_m, high_m]: [f32; 2], out: &mut [[f32; N]; 3]) {
        // Heights are relative to the set, so that all mountains have meadows at the foot and rock above.
        let span = (high_m - low_m).max(1.0);
        let tall = smooth(300.0, 1800.0, span);
        let hilly = smooth(100.0, 700.0, span);
        let scales_m = [4.0, 16.0, 64.0].map(|s| s * self.step_m[1] as f32);
        let [red, green, blue] = out;
        let Palette { meadow: meadows, forest: forests, alpine: alps, rock: rocks, scree, snow } = self.palette;
        for k in 0..N {
            let (h, patch, grain) = (self.height[k], self.patch[k], self.grain[k]);
            let slope = (self.east[k] * self.east[k] + self.north[k] * self.north[k]).sqrt();
            // Snow depends on the height above the sea, not on the relative height.
            let snow_line = smooth(2300.0, 2900.0, h + 260.0 * patch + 60.0 * grain);
            let t = (h - low_m) / span + 0.05 * patch;
            let wood = smooth(-0.10, 0.42, patch + 0.30 * smooth(0.1, 0.4, slope) + 0.06 * grain);
            let high = hilly * smooth(0.42, 0.58, t);
            let loose = 0.7 * tall * smooth(0.60, 0.74, t);
            let steep = smooth(0.45, 0.85, slope + 0.08 * grain);
            let snowy = snow_line * (1.0 - smooth(0.75, 1.25, slope));
            // Ambient shading: the depth of the point below its surroundings at three scales.
            let mut open = 0.0;
            for (around, scale_m) in self.around.iter().zip(scales_m) {
                open += (h - around[k]) / scale_m;
            }
            let ambient = 1.0 + 0.55 * (open / (0.25 + open.abs())).clamp(-0.62, 0.35);
            let shade = ambient * (1.0 + 0.05 * grain);
            let meadow = (0.5 + 0.9 * patch).clamp(0.0, 1.0);
            let forest = (0.5 + 0.5 * grain).clamp(0.0, 1.0);
            let alpine = (0.5 + patch).clamp(0.0, 1.0);
            let rock = (0.5 + 0.5 * grain + 0.3 * patch).clamp(0.0, 1.0);
            let channel = |c: usize| {
                let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
                let pair = |p: &[[f32; 3]; 2], t: f32| mix(p[0][c], p[1][c], t);
                let mut color = mix(pair(meadows, meadow), pair(forests, forest), wood);
                color = mix(color, pair(alps, alpine), high);
                color = mix(color, scree[c], loose);
                color = mix(color, pair(rocks, rock), steep);
                color = mix(color, snow[c], snowy);
                color * shade
            };
            red[k] = channel(0);
            green[k] = channel(1);
            blue[k] = channel(2);
        }
    }
}

/// The colours of ground, sRGB 0..255. Pairs are mixed by noise.
struct Palette {
    meadow: [[f32; 3]; 2],
    forest: [[f32; 3]; 2],
    alpine: [[f32; 3]; 2],
    rock: [[f32; 3]; 2],
    scree: [f32; 3],
    snow: [f32; 3],
}

const EARTH: Palette = Palette {
    meadow: [[104.0, 122.0, 62.0], [134.0, 138.0, 82.0]],
    forest: [[58.0, 82.0, 46.0], [76.0, 98.0, 54.0]],
    alpine: [[122.0, 122.0, 84.0], [104.0, 104.0, 76.0]],
    rock: [[112.0, 106.0, 98.0], [140.0, 132.0, 120.0]],
    scree: [148.0, 142.0, 132.0],
    snow: [240.0, 244.0, 250.0],
};

/// Bare ground: dust on plains, rock on slopes.
const GREY: Palette =
    Palette::bare([[104.0, 103.0, 101.0], [128.0, 126.0, 122.0]], [[126.0, 124.0, 120.0], [156.0, 153.0, 148.0]]);
const RED: Palette =
    Palette::bare([[150.0, 94.0, 64.0], [178.0, 116.0, 80.0]], [[122.0, 76.0, 54.0], [156.0, 102.0, 74.0]]);

impl Palette {
    const fn bare(dust: [[f32; 3]; 2], rock: [[f32; 3]; 2]) -> Self {
        Self { meadow: dust, forest: dust, alpine: dust, rock, scree: rock[1], snow: rock[1] }
    }
}

/// Interpolates one lattice along a row of texels: first between two rows of samples, then along them.
struct LevelRow {
    /// The column of the first sample in `lines`, one left of the first that is needed.
    first: i64,
    /// For each texel the index in `lines` of the sample left of it, and its distance from there to the next, 0..1.
    columns: Vec<(usize, f32)>,
    /// Samples at the latitude of the texels, and those one row south and one row north of it.
    lines: [Vec<f32>; 3],
}

impl LevelRow {
    fn new(lattice: &Lattice<'_>, u: [f64; 2]) -> Self {
        let cells = lattice.cells;
        let column = |k: usize| {
            let u = u[0] + (u[1] - u[0]) * (k as f64 / (N - 1) as f64);
            let x = (u * cells as f64).max(0.0);
            let left = (x as i64).min(cells - 1);
            (left, (x - left as f64).min(1.0) as f32)
        };
        let (first, last) = (column(0).0, column(N - 1).0);
        let columns = (0..N).map(column).map(|(left, f)| ((left - first) as usize + 1, f)).collect();
        // One more sample on the left, and two on the right: the last texel's neighbour and one for its slope.
        Self { first: first - 1, columns, lines: [0; 3].map(|_| vec![0.0; (last - first) as usize + 4]) }
    }

    /// Interpolates between the two rows of samples around `v` shifted by `rows`. Outside of the set the nearest column
    /// is repeated.
    fn line(&mut self, lattice: &Lattice<'_>, v: f64, which: usize, rows: f64) {
        let last = lattice.cells as f64;
        let y = (v * last + rows).clamp(0.0, last);
        let y0 = (y as i64).min(lattice.cells - 1);
        let f = (y - y0 as f64) as f32;
        for (k, out) in self.lines[which].iter_mut().enumerate() {
            let x = self.first + k as i64;
            let (a, b) = (lattice.samples.at(x, y0), lattice.samples.at(x, y0 + 1));
            *out = a + (b - a) * f;
        }
    }

    /// Computes the heights of the texels in the row `v`.
    fn heights(&mut self, lattice: &Lattice<'_>, v: f64, out: &mut [f32; N]) {
        self.line(lattice, v, 0, 0.0);
        let line = &self.lines[0];
        for ((left, f), out) in self.columns.iter().zip(out) {
            *out = line[*left] + (line[left + 1] - line[*left]) * f;
        }
    }

    /// Computes the heights, and their differences over two samples eastwards and northwards.
    fn slopes(&mut self, lattice: &Lattice<'_>, v: f64, out: &mut [f32; N], east: &mut [f32; N], north: &mut [f32; N]) {
        self.heights(lattice, v, out);
        self.line(lattice, v, 1, -1.0);
        self.line(lattice, v, 2, 1.0);
        let [line, below, above] = &self.lines;
        for (k, (left, f)) in self.columns.iter().enumerate() {
            let i = *left;
            let at_left = line[i + 1] - line[i - 1];
            east[k] = at_left + (line[i + 2] - line[i] - at_left) * f;
            let at_left = above[i] - below[i];
            north[k] = at_left + (above[i + 1] - below[i + 1] - at_left) * f;
        }
    }
}

/// Returns 0 below `low`, 1 above `high`, and a smooth step between them.
fn smooth(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
