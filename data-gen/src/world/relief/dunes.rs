//! Dunes: sand that the wind has shaped. Where sand is thin, single barchans with horns downwind lie on bare ground. Where it is
//! thick, crests lie across the wind, or along it where winds of two seasons meet. Lee sides lie at the angle of repose.

use super::super::points::Points;
use super::super::preset::Relief;
use super::barchans::add_barchans;
use super::noise::Vectors;
use super::waves::{from_whole, waves};
use super::{Ground, REPOSE, Scratch, add_noise, add_octaves, part_seed, reset, smooth};

/// Height of the largest dunes that the sizes below belong to.
const HEIGHT_M: f32 = 120.0;

/// A family of long dunes. Waves are coherent within a cell.
struct Family {
    part: u32,
    cell_m: f64,
    /// The number of crests in a cell.
    crests: f32,
    height_m: f32,
    /// Crests lie along the wind.
    is_linear: bool,
}

const FAMILIES: [Family; 5] = [
    Family { part: 44, cell_m: 5_600.0, crests: 3.4, height_m: HEIGHT_M, is_linear: false },
    Family { part: 45, cell_m: 13_000.0, crests: 7.0, height_m: 0.8 * HEIGHT_M, is_linear: true },
    Family { part: 46, cell_m: 1_500.0, crests: 3.6, height_m: 17.0, is_linear: false },
    Family { part: 47, cell_m: 330.0, crests: 3.6, height_m: 3.2, is_linear: false },
    Family { part: 48, cell_m: 60.0, crests: 3.6, height_m: 0.5, is_linear: false },
];
/// Barchans: the cells that have one each, in metres.
const BARCHANS_M: [f64; 2] = [1_300.0, 520.0];

/// Returns the height, 0..1, of a dune across which the wind blows, at a place in turns of the wave within -0.5..0.5: a gentle
/// windward side, a crest, and a lee that is `lee` turns wide.
#[inline(always)]
fn across(turn: f32, lee: f32) -> f32 {
    let t = turn + 0.5;
    let up = (t / (1.0 - lee)).min(1.0);
    // Concave at the foot and round towards the crest.
    let windward = up * (0.45 + up * (1.1 - 0.55 * up));
    windward.min((1.0 - t) / lee)
}

/// Returns the height, 0..1, of a dune along the wind: two sides that meet in a crest, and bare ground between dunes.
#[inline(always)]
fn along(turn: f32) -> f32 {
    let t = (1.0 - turn.abs() / 0.34).max(0.0);
    t * (0.55 + 0.45 * t)
}

impl Relief {
    /// Computes the thickness of sand in `scratch.sand`: it gathers on plains.
    pub(super) fn add_sand(&self, seed: u64, points: &Points, s: &mut Scratch, out: &Ground) {
        let n = points.len();
        reset(&mut s.sand, n);
        if self.forms.dune_m <= 0.0 {
            s.sand.fill(-1.0);
            return;
        }
        add_octaves(points, 90_000.0, 4, 0.5, 1.0, part_seed(seed, 50), &mut s.sand);
        // Worlds with craters have little sand: it would have buried them.
        let share = if self.forms.craters > 0.0 { -0.4 } else { 0.06 };
        for k in 0..n {
            // Two places on the earth have no direction across the axis that the wind turns around.
            let [x, y, z] = cross(AXIS, place(points, k));
            let poles = smooth(0.05, 0.02, x * x + y * y + z * z);
            s.sand[k] += share - 1.6 * smooth(0.02, 0.4, out.mountain[k]) - 2.0 * poles;
        }
    }

    /// Adds dunes where sand is.
    pub(super) fn add_dunes(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let (n, scale) = (points.len(), self.forms.dune_m / HEIGHT_M);
        if scale <= 0.0 {
            return;
        }
        let has_single = |sand: f32| sand > -0.42;
        if !s.sand.iter().any(|sand| has_single(*sand)) {
            return;
        }
        self.set_wind(seed, points, s);
        for v in [&mut s.noise, &mut s.other, &mut s.detail, &mut s.strength, &mut s.slope] {
            reset(v, n);
        }
        // Height of the sand, single dunes first.
        for (k, cell_m) in BARCHANS_M.into_iter().enumerate() {
            let part = part_seed(seed, 40 + k as u32);
            add_barchans(points, points.radius_m / cell_m, part, &s.gradient, REPOSE, cell_m as f32, &mut s.noise);
        }
        for k in 0..n {
            let sand = s.sand[k];
            s.noise[k] *= smooth(-0.42, -0.2, sand) * smooth(0.22, 0.0, sand) * scale;
            s.slope[k] = s.noise[k];
        }
        if s.sand.iter().any(|sand| *sand > 0.0) {
            self.add_long_dunes(seed, points, scale, s);
        }
        for k in 0..n {
            let sand = s.sand[k];
            let height_m = s.slope[k] * smooth(0.0, -0.8, out.depth_m[k]);
            let thick = smooth(-0.06, 0.14, sand);
            // Below dunes lies a sheet of sand.
            let sheet_m = 0.25 * self.forms.dune_m * smooth(-0.1, 0.6, sand);
            out.bed_m[k] += height_m + sheet_m;
            out.surface_m[k] += height_m + sheet_m;
            // Sand that is thin lets the ground through.
            out.cover[k] = (0.35 * smooth(-0.3, 0.0, sand)).max(thick).max(smooth(0.2, 1.6, height_m));
            let high = (height_m / self.forms.dune_m).min(1.0) - 0.35;
            out.ridge[k] += 1.3 * high * thick;
        }
    }

    /// Adds the dunes of thick sand to `scratch.slope`. `scratch.gradient` is the wind.
    fn add_long_dunes(&self, seed: u64, points: &Points, scale: f32, s: &mut Scratch) {
        let n = points.len();
        // The noises say where the winds of two seasons meet, and how much crests vary in height.
        add_octaves(points, 150_000.0, 2, 0.5, 1.0, part_seed(seed, 42), &mut s.detail);
        add_octaves(points, 2_600.0, 2, 0.5, 1.0, part_seed(seed, 43), &mut s.strength);
        for family in &FAMILIES {
            s.total.reset(n);
            for k in 0..n {
                let (p, w) = (place(points, k), s.gradient.at(k));
                let q = if family.is_linear { cross(p, w) } else { w };
                let crests = family.crests * (1.0 + 0.06 * s.strength[k]);
                (s.total.x[k], s.total.y[k], s.total.z[k]) = (crests * q[0], crests * q[1], crests * q[2]);
            }
            let part = part_seed(seed, family.part);
            // Phases and strengths of the waves.
            let (turns, strengths) = (&mut s.noise, &mut s.other);
            waves(points, points.radius_m / family.cell_m, part, &s.total, turns, strengths);
            let length_m = family.cell_m as f32 / family.crests;
            let is_large = family.height_m > 0.5 * HEIGHT_M;
            for k in 0..n {
                // Crests wind, and no two are of one height.
                let turn = from_whole(turns[k] + if is_large { 0.3 * s.strength[k] } else { 0.0 });
                let sand = s.sand[k];
                let two = smooth(-0.02, 0.16, s.detail[k]);
                let share = match is_large {
                    true if family.is_linear => two,
                    true => 1.0 - two,
                    // Small dunes ride on the windward sides of large ones.
                    false => 0.55 + 0.45 * (s.slope[k] / (0.4 * self.forms.dune_m)).min(1.0),
                };
                let varied = (0.7 + 0.65 * s.strength[k]).max(0.1);
                let height_m = scale
                    * family.height_m
                    * share
                    * varied
                    * smooth(0.0, if is_large { 0.4 } else { 0.15 }, sand)
                    * smooth(0.04, 0.42, strengths[k]);
                let lee = (height_m / (REPOSE * length_m)).clamp(0.02, 0.45);
                let shape = if family.is_linear { along(turn) } else { across(turn, lee) };
                s.slope[k] += height_m * shape;
            }
        }
    }

    /// Writes the directions of the wind to `scratch.gradient`. They turn slowly.
    fn set_wind(&self, seed: u64, points: &Points, s: &mut Scratch) {
        let n = points.len();
        reset(&mut s.noise, n);
        add_noise(points, points.radius_m / 600_000.0, part_seed(seed, 49), 1.4, &mut s.noise);
        let Vectors { x, y, z } = &mut s.gradient;
        for out in [&mut *x, &mut *y, &mut *z] {
            reset(out, n);
        }
        for k in 0..n {
            let p = place(points, k);
            let east = unit(cross(AXIS, p));
            let north = cross(p, east);
            let turn = s.noise[k];
            let wind = unit([east[0] + turn * north[0], east[1] + turn * north[1], east[2] + turn * north[2]]);
            (x[k], y[k], z[k]) = (wind[0], wind[1], wind[2]);
        }
    }
}

/// The axis that the wind turns around.
const AXIS: [f32; 3] = [0.36, -0.48, 0.8];

fn place(points: &Points, k: usize) -> [f32; 3] {
    [points.x[k] as f32, points.y[k] as f32, points.z[k] as f32]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt().max(1e-6);
    [v[0] / length, v[1] / length, v[2] / length]
}

#[cfg(test)]
mod tests {
    use super::super::super::points::{RADIUS_M, meridians};
    use super::super::super::surface::RowBuffers;
    use super::super::super::{World, WorldPreset};
    use super::*;

    #[test]
    fn lee_sides_lie_at_the_angle_of_repose() {
        let (height_m, length_m) = (80.0, 1_600.0);
        let lee = height_m / (REPOSE * length_m);
        let heights: Vec<f32> = (0..=1_600).map(|m| height_m * across(m as f32 / 1_600.0 - 0.5, lee)).collect();
        assert!(heights[0].abs() < 1e-3 && heights[1_600].abs() < 1e-3, "waves join");
        let steps: Vec<f32> = heights.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let (steepest, gentlest) = steps.iter().fold((0.0f32, 0.0f32), |(up, down), s| (up.max(*s), down.min(*s)));
        assert!((gentlest + REPOSE).abs() < 0.02 && steepest < 0.12, "{steepest} up, {gentlest} down");
        assert!((along(0.0), along(0.5)) == (1.0, 0.0));
    }

    /// Sand is nowhere much steeper than it can be, and some of it is as steep as that.
    #[test]
    fn sand_of_a_desert_is_as_steep_as_loose_sand_can_be() {
        let world = World::new(WorldPreset::Desert, 1);
        let mut row = RowBuffers::default();
        let (mut steps, mut steep, mut steeper) = (0, 0, 0);
        for latitude in (-30..30).map(|k| 0.02 * f64::from(k)) {
            for west in (0..24).map(|k| 0.25 * f64::from(k)) {
                // Twelve metres apart.
                let longitudes = meridians((0..96).map(|k| west + f64::from(k) * 12.0 / RADIUS_M));
                world.ground_row(&longitudes, latitude, &mut row);
                let ground = &row.ground;
                let is_sand = |k: usize| ground.cover[k] > 0.99 && ground.mountain[k] == 0.0;
                for k in (1..96).filter(|k| is_sand(*k) && is_sand(k - 1)) {
                    let east_m = 12.0 * latitude.cos() as f32;
                    let slope = (ground.bed_m[k] - ground.bed_m[k - 1]).abs() / east_m;
                    steps += 1;
                    steep += usize::from(slope > 0.45);
                    steeper += usize::from(slope > 0.9);
                }
            }
        }
        assert!(steps > 2_000 && steep * 100 > steps, "{steep} steep ones of {steps} steps");
        assert!(steeper * 200 < steps, "{steeper} of {steps} steps are too steep");
    }
}
