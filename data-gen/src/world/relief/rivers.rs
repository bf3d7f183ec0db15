//! Cuts the valleys of rivers and the basins of lakes into the ground along a row.

use super::super::points::{Points, RADIUS_M};
use super::super::preset::{Flow, Relief};
use super::drainage::{Cell, Channel, Lake, Network, difference_m, dot};
use super::{Basin, FAR_M, Ground, Scratch, add_noise, part_seed, reset, smooth};

/// Depth of the sea from which on rivers have no effect.
const SEA_M: f32 = -40.0;

/// Returns the larger value, rounded where they differ by less than `width`, and exact elsewhere.
fn round_max(a: f32, b: f32, width: f32) -> f32 {
    let larger = a.max(b);
    let t = (1.0 - (a - b).abs() / width).max(0.0);
    larger + 0.25 * width * t * t
}

/// What a river or a lake does to a place.
struct Effect {
    /// Bounds of the height of the ground.
    lowest_m: f32,
    highest_m: f32,
    /// Height of the water, and the distance from its bank, below 0 in it.
    water_m: f32,
    bank_m: f32,
}

impl Channel {
    /// Returns the share of the way from the upper to the lower end, the distance from the river's middle, and the way from
    /// there.
    #[inline]
    pub(super) fn nearest(&self, at: [f64; 3]) -> (f32, f32, [f32; 3]) {
        let to = difference_m(self.from, at);
        let t = (dot(to, self.along_m) * self.per_length2).clamp(0.0, 1.0);
        let a = self.along_m;
        let off = [to[0] - t * a[0], to[1] - t * a[1], to[2] - t * a[2]];
        (t, dot(off, off).sqrt(), off)
    }

    /// Returns half the width at a share of the way: rivers begin with none.
    pub(super) fn half_width_m(&self, t: f32) -> f32 {
        let half = self.half_m[0] + (self.half_m[1] - self.half_m[0]) * t;
        if self.is_source { half * smooth(0.5, 0.9, t) } else { half }
    }

    /// Returns the height of the water at a share of the way, and that without the lake or the sea at the lower end.
    pub(super) fn water_m(&self, t: f32) -> [f32; 2] {
        let t = ((t - self.in_lake) / (1.0 - self.in_lake)).max(0.0);
        let [high, low] = self.levels_m;
        // Rivers fall more at first, as they have cut in more there.
        let raw = high + (low - high) * (t * (1.7 - 0.7 * t));
        [raw.max(self.floor_m), raw]
    }

    /// Returns the distance from the bank, below 0 in the river, and half the width.
    pub(super) fn bank_m(&self, at: [f64; 3]) -> [f32; 2] {
        let (t, distance_m, _) = self.nearest(at);
        let half_m = self.half_width_m(t);
        [distance_m - half_m, half_m]
    }

    #[inline]
    fn effect(&self, relief: &Relief, at: [f64; 3], ground_m: f32) -> Effect {
        let rivers = &relief.rivers;
        let (t, distance_m, _) = self.nearest(at);
        let half_m = self.half_width_m(t);
        let [water_m, raw_m] = self.water_m(t);
        let bank_m = distance_m - half_m;
        // Sources lie on the ground.
        let strength = if self.is_source { smooth(0.0, 0.5, t) } else { 1.0 };
        let spacing_m = rivers.spacing_m as f32;
        let bed_m = match bank_m < 0.0 {
            _ if rivers.flow == Flow::Ice => self.ice_m(t, distance_m, half_m),
            true => (0.6 + 0.07 * half_m) * bank_m / (half_m + 0.01),
            false => (0.5 * bank_m).min(1.5),
        };
        let plain_m = if rivers.flow == Flow::Ice { 60.0 } else { 3.0 * half_m + 15.0 };
        let side_m = (bank_m - plain_m).max(0.0);
        let slope_m = rivers.slope * side_m * side_m / (side_m + 0.12 * spacing_m);
        let far = smooth(0.1 * spacing_m, 0.75 * spacing_m, distance_m);
        let head_m = (1.0 - strength) * (60.0 + 1.2 * rivers.incision_m);
        let valley_m = water_m + bed_m + 0.01 * bank_m.max(0.0) + slope_m + head_m;
        let highest_m = valley_m + (ground_m - valley_m).max(0.0) * far;
        // No dams in the sea.
        let mouth_m = if relief.has_sea { 20.0 * (3.0 - raw_m).max(0.0) } else { 0.0 };
        let lowest_m = water_m + bed_m - 0.1 * side_m - 4.0 * head_m - mouth_m - 3_000.0 * far;
        Effect { lowest_m, highest_m, water_m, bank_m }
    }
}

impl Lake {
    fn effect(&self, at: [f64; 3], spacing_m: f32, ground_m: f32) -> Effect {
        let to = difference_m(self.at, at);
        let distance_m = dot(to, to).sqrt();
        let radius_m = self.radius_m;
        // A basin in the middle. Around it, the ground decides where the shore is.
        let beyond_m = distance_m - 0.4 * radius_m;
        let basin_m = if beyond_m < 0.0 { 0.07 * beyond_m } else { 0.35 * beyond_m };
        let far = smooth(0.2 * spacing_m, 0.75 * spacing_m, distance_m);
        let basin_m = self.level_m + basin_m;
        // A low dam where the ground around the lake is lower than the water.
        let bank_m = distance_m - radius_m;
        let dam_m = 0.8 + if bank_m < 0.0 { 0.3 * bank_m } else { -0.07 * bank_m };
        Effect {
            lowest_m: self.level_m + dam_m - 3_000.0 * far,
            highest_m: basin_m + (ground_m - basin_m).max(0.0) * far,
            water_m: self.level_m,
            bank_m,
        }
    }
}

impl Relief {
    pub(super) fn add_rivers(
        &self,
        basin: Basin<'_>,
        points: &Points,
        network: &mut Network,
        s: &mut Scratch,
        out: &mut Ground,
    ) {
        if self.rivers.spacing_m <= 0.0 {
            return;
        }
        let n = points.len();
        let in_reach = |bed: f32| !self.has_sea || bed > SEA_M;
        let cells: Vec<Cell> =
            points.longitudes.iter().map(|longitude| basin.drainage.cell(*longitude, points.latitude)).collect();
        let mut wanted: Vec<Cell> =
            cells.iter().zip(&out.bed_m).filter(|(_, bed)| in_reach(**bed)).map(|(cell, _)| *cell).collect();
        wanted.sort_unstable();
        wanted.dedup();
        if wanted.is_empty() {
            return;
        }
        network.prepare(basin, &wanted);
        self.add_bends(basin.seed, points, s, out);
        let spacing_m = self.rivers.spacing_m as f32;
        let mut waters = None;
        for k in 0..n {
            if !in_reach(out.bed_m[k]) {
                continue;
            }
            if k == 0 || cells[k] != cells[k - 1] || waters.is_none() {
                waters = network.waters(cells[k]);
            }
            let Some(waters) = &waters else { continue };
            let at = bent(points.at(k), out.bend_m.at(k));
            let ground_m = out.bed_m[k];
            let (mut lowest_m, mut highest_m) = (f32::MIN, f32::MAX);
            let (mut river_m, mut stream_m) = (f32::MAX, FAR_M);
            for channel in &waters.channels {
                let effect = channel.effect(self, at, ground_m);
                lowest_m = lowest_m.max(effect.lowest_m);
                highest_m = highest_m.min(effect.highest_m);
                stream_m = stream_m.min(effect.bank_m);
                // Where rivers meet, the lower one goes on.
                if effect.bank_m < 0.0 {
                    river_m = river_m.min(effect.water_m);
                }
            }
            let (mut lake_m, mut shore_m) = (f32::MIN, f32::MAX);
            for lake in &waters.lakes {
                let effect = lake.effect(at, spacing_m, ground_m);
                lowest_m = lowest_m.max(effect.lowest_m);
                highest_m = highest_m.min(effect.highest_m);
                if effect.bank_m < shore_m {
                    (shore_m, lake_m) = (effect.bank_m, effect.water_m);
                }
            }
            let mut bed_m = ground_m;
            let raised = if self.has_sea { smooth(-8.0, 2.0, ground_m) } else { 1.0 };
            if lowest_m > ground_m && raised > 0.0 {
                bed_m += (lowest_m - ground_m) * raised;
            }
            // Valleys keep the roughness and the layers of the ground.
            let on_bank = smooth(0.0, 60.0, stream_m.min(shore_m + 0.4 * spacing_m));
            let mut cut_m = highest_m + s.noise[k] * on_bank;
            if self.layer_m > 0.0 && highest_m < ground_m {
                let deep = smooth(0.0, 0.5 * self.layer_m, ground_m - highest_m);
                cut_m += (self.stepped(cut_m) - cut_m) * smooth(0.0, 120.0, stream_m) * deep;
            }
            let width_m = 12.0 * smooth(5.0, 200.0, stream_m.min(shore_m.max(0.0))) + 0.1;
            bed_m = -round_max(-bed_m, -cut_m, width_m);
            // Sand buries valleys.
            let buried = smooth(0.0, 0.2, s.sand[k]);
            bed_m += (ground_m - bed_m) * buried;
            stream_m += (FAR_M - stream_m) * buried;
            let dried_up_m = bed_m;
            if self.rivers.flow == Flow::Dry && shore_m < 0.0 {
                // Salt fills the basins of lakes up to their shores.
                bed_m += (lake_m - 0.3 - bed_m).max(0.0) * (1.0 - buried);
            }
            out.bed_m[k] = bed_m;
            let sea_m = if self.has_sea { 0.0 } else { f32::MIN };
            let mut surface_m = bed_m.max(sea_m);
            out.depth_m[k] = (sea_m - bed_m).max(-30.0);
            if shore_m < 0.0 {
                surface_m = surface_m.max(lake_m);
            }
            if lake_m > f32::MIN {
                let depth_m = (lake_m - dried_up_m).min(-0.2 * shore_m);
                out.depth_m[k] = out.depth_m[k].max(depth_m - 30.0 * buried);
            }
            if stream_m < 0.0 {
                surface_m = surface_m.max(river_m);
            }
            if self.rivers.flow == Flow::Ice {
                out.cover[k] = smooth(20.0, -40.0, stream_m);
            }
            if self.rivers.flow != Flow::Water {
                surface_m = bed_m.max(sea_m);
            }
            out.surface_m[k] = surface_m;
            out.stream_m[k] = stream_m;
        }
    }

    /// Computes the bends of rivers: a way to each place, which varies along the ground.
    fn add_bends(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let Ground { bend_m, .. } = out;
        reset(&mut s.other, points.len());
        for (k, bend) in [&mut bend_m.x, &mut bend_m.y, &mut bend_m.z].into_iter().enumerate() {
            for (octave, (length, strength)) in [(0.7, 0.16), (0.22, 0.05), (0.08, 0.014)].into_iter().enumerate() {
                let frequency = RADIUS_M / (length * self.rivers.spacing_m);
                let amplitude_m = (strength * self.rivers.spacing_m) as f32;
                add_noise(points, frequency, part_seed(seed, 110 + 3 * k as u32 + octave as u32), amplitude_m, bend);
            }
        }
    }
}

/// Returns a point moved by a bend in metres.
pub(crate) fn bent(at: [f64; 3], bend_m: [f32; 3]) -> [f64; 3] {
    let along = |axis: usize| at[axis] + f64::from(bend_m[axis]) / RADIUS_M;
    [along(0), along(1), along(2)]
}

#[cfg(test)]
mod tests {
    use super::super::super::planet::RowBuffers;
    use super::super::super::points::meridians;
    use super::super::super::{World, WorldPreset};
    use super::*;

    const PRESETS: [WorldPreset; 4] =
        [WorldPreset::Earthlike, WorldPreset::Alps, WorldPreset::Islands, WorldPreset::Canyon];

    /// Computes the ground at a point.
    fn set_ground(world: &World, [x, y, z]: [f64; 3], row: &mut RowBuffers) {
        let latitude = (z / (x * x + y * y + z * z).sqrt()).asin();
        world.ground_row(&meridians(std::iter::once(y.atan2(x))), latitude, row);
    }

    /// Computes the ground at the place that bends move to a point.
    fn set_ground_on(world: &World, point: [f64; 3], row: &mut RowBuffers) {
        let mut at = point;
        for _ in 0..40 {
            set_ground(world, at, row);
            let bend_m = row.ground.bend_m.at(0);
            at = [0, 1, 2].map(|axis| point[axis] - f64::from(bend_m[axis]) / RADIUS_M);
        }
        set_ground(world, at, row);
    }

    /// Returns the nodes of some cells around the place with much relief of a world.
    fn cells(world: &World) -> Vec<Cell> {
        let [longitude, latitude] = world.place(40_000.0);
        world.basin().drainage.around(world.basin().drainage.cell(longitude, latitude), 6, 6).collect()
    }

    #[test]
    fn water_never_rises_along_a_river() {
        let (mut links, mut wet) = (0, 0);
        for (preset, seed) in PRESETS.iter().flat_map(|preset| [1, 2].map(|seed| (*preset, seed))) {
            let world = World::new(preset, seed);
            let mut row = RowBuffers::default();
            let mut network = Network::default();
            for source in cells(&world).into_iter().step_by(7) {
                let mut cell = source;
                let mut last_m = f32::MAX;
                for _ in 0..8 {
                    let Some(channel) = network.channel(world.basin(), cell) else { break };
                    links += 1;
                    for k in 0..=12 {
                        let t = f64::from(k) / 12.0;
                        let point =
                            [0, 1, 2].map(|axis| channel.from[axis] + t * f64::from(channel.along_m[axis]) / RADIUS_M);
                        set_ground_on(&world, point, &mut row);
                        let (surface_m, stream_m) = (row.ground.surface_m[0], row.ground.stream_m[0]);
                        if stream_m < -0.5 {
                            wet += 1;
                            assert!(surface_m <= last_m + 0.01, "{preset:?} {seed}: {surface_m} m after {last_m} m");
                            assert!(row.ground.bed_m[0] < surface_m, "{preset:?} {seed}: dry at {surface_m} m");
                            last_m = surface_m;
                        }
                    }
                    let Some(down) = network.course(world.basin(), cell).down else { break };
                    cell = down;
                }
            }
        }
        assert!(links > 200 && wet > 2 * links, "{links} links, {wet} places in rivers");
    }

    #[test]
    fn lakes_are_level_and_lie_below_their_shores() {
        let mut lakes = 0;
        for (preset, seed) in PRESETS.iter().flat_map(|preset| [1, 2].map(|seed| (*preset, seed))) {
            let world = World::new(preset, seed);
            let mut row = RowBuffers::default();
            let mut network = Network::default();
            let cells = cells(&world);
            network.prepare(world.basin(), &cells);
            let found: Vec<Lake> = cells.iter().filter_map(|cell| network.lake(world.basin(), *cell)).collect();
            assert!(preset != WorldPreset::Canyon || found.is_empty());
            for lake in found.iter().take(3) {
                lakes += 1;
                let mut wet = 0;
                for (i, j) in (-4i32..=4).flat_map(|i| (-4i32..=4).map(move |j| (i, j))) {
                    let step = f64::from(lake.radius_m) / 5.0 / RADIUS_M;
                    let point = [lake.at[0], lake.at[1] + step * f64::from(i), lake.at[2] + step * f64::from(j)];
                    set_ground_on(&world, point, &mut row);
                    let ground = &row.ground;
                    if ground.stream_m[0] > 0.0 && ground.depth_m[0] > 0.0 {
                        wet += 1;
                        assert_eq!(ground.surface_m[0], lake.level_m, "{preset:?} {seed}");
                    }
                }
                assert!(wet > 5, "{preset:?} {seed}: a lake with {wet} places of water");
            }
        }
        assert!(lakes > 8, "{lakes} lakes");
    }
}
