//! Cuts the valleys of rivers and the basins of lakes into the ground along a row.

use super::super::points::Points;
use super::super::preset::{Flow, Relief};
use super::drainage::{Cell, Channel, Lake, Network, Waters, difference_m, dot, minus};
use super::lattice::{LANES, Lanes, lanes};
use super::noise::Vectors;
use super::{Basin, FAR_M, Ground, Scratch, add_noise, part_seed, smooth, wide};

/// Depth of the sea from which on rivers have no effect.
const SEA_M: f32 = -40.0;
/// A river whose water is higher over the ground than the first, plus the second for each metre from the bank, has lost its bed.
/// The beds that rivers cut are at most a third as deep.
const MAX_DEPTH_M: f32 = 3.0;
const MAX_DEPTH_PER_M: f32 = 0.2;

/// Returns the larger value, rounded where they differ by less than `width`, and exact elsewhere.
fn round_max(a: f32, b: f32, width: f32) -> f32 {
    let larger = a.max(b);
    let t = (1.0 - (a - b).abs() / width).max(0.0);
    larger + 0.25 * width * t * t
}

/// The effects of the rivers and lakes of a cell on positions in it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Effects {
    /// The positions, moved by the bends, in metres from the middle of the cell.
    at_m: Vectors,
    middle_m: [f32; 3],
    radius_m: f32,
    /// Bounds of the height of the ground.
    lowest_m: Vec<f32>,
    highest_m: Vec<f32>,
    /// Height of the water, and the distance from its bank, below 0 in it: of rivers and of the nearest lake.
    river_m: Vec<f32>,
    stream_m: Vec<f32>,
    lake_m: Vec<f32>,
    shore_m: Vec<f32>,
    /// How near the nearest river or lake is: 0 where none has an effect.
    near: Vec<f32>,
}

impl Effects {
    fn reset(&mut self, len: usize) {
        self.at_m.reset(len);
        for (buffer, value) in [
            (&mut self.lowest_m, f32::MIN),
            (&mut self.highest_m, f32::MAX),
            (&mut self.river_m, f32::MAX),
            (&mut self.stream_m, FAR_M),
            (&mut self.lake_m, f32::MIN),
            (&mut self.shore_m, f32::MAX),
            (&mut self.near, 0.0),
        ] {
            buffer.clear();
            buffer.resize(len, value);
        }
    }

    /// Sets the places, and the circle around them.
    fn set_places(&mut self, places: impl ExactSizeIterator<Item = [f32; 3]>) {
        self.reset(places.len());
        for (k, at) in places.enumerate() {
            (self.at_m.x[k], self.at_m.y[k], self.at_m.z[k]) = (at[0], at[1], at[2]);
        }
        let [first, last] = [0, self.near.len() - 1].map(|k| self.at_m.at(k));
        self.middle_m = [0, 1, 2].map(|k| 0.5 * (first[k] + last[k]));
        // The bends can lead away from the line from the first to the last place.
        let mut squared = 0.0f32;
        for k in 0..self.near.len() {
            let off = minus(self.at_m.at(k), self.middle_m);
            squared = squared.max(dot(off, off));
        }
        self.radius_m = squared.sqrt();
    }

    /// Returns a distance that no place is nearer than to a line of some length that begins at `from`.
    fn distance_m(&self, from: [f32; 3], along_m: [f32; 3]) -> f32 {
        let off = minus(self.middle_m, from);
        let t = (dot(off, along_m) / dot(along_m, along_m).max(1.0)).clamp(0.0, 1.0);
        let off = [off[0] - t * along_m[0], off[1] - t * along_m[1], off[2] - t * along_m[2]];
        dot(off, off).sqrt() - self.radius_m
    }
}

impl Channel {
    /// Returns the share of the way from the upper to the lower end, the distance from the river's middle, and the way from
    /// there, for a place in metres from the middle of the cell that the channel was found for.
    #[inline(always)]
    pub(super) fn nearest(&self, at_m: [f32; 3]) -> (f32, f32, [f32; 3]) {
        let to = minus(at_m, self.from_m);
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

    /// Returns true if a place is farther from the banks than a distance, wherever along the river it is.
    #[inline(always)]
    pub(super) fn is_farther(&self, at_m: [f32; 3], from_bank_m: f32) -> bool {
        let to = minus(at_m, self.from_m);
        let t = (dot(to, self.along_m) * self.per_length2).clamp(0.0, 1.0);
        let off = [to[0] - t * self.along_m[0], to[1] - t * self.along_m[1], to[2] - t * self.along_m[2]];
        let reach_m = self.half_m[0].max(self.half_m[1]) + from_bank_m;
        dot(off, off) > reach_m * reach_m
    }

    /// Returns the distance from the bank, below 0 in the river, and half the width.
    pub(super) fn bank_m(&self, at_m: [f32; 3]) -> [f32; 2] {
        let (t, distance_m, _) = self.nearest(at_m);
        let half_m = self.half_width_m(t);
        [distance_m - half_m, half_m]
    }

    /// Adds the effect on the places of a cell, whose ground is given.
    fn add_effect<const ICE: bool>(&self, relief: &Relief, ground_m: &[f32], e: &mut Effects) {
        let reach_m = (0.75 * relief.rivers.spacing_m as f32).max(FAR_M + self.half_m[1]);
        if e.distance_m(self.from_m, self.along_m) > reach_m {
            return;
        }
        wide(
            #[inline(always)]
            || {
                for start in (0..ground_m.len()).step_by(LANES) {
                    self.add_effect_on_block::<ICE>(relief, start, ground_m, e);
                }
            },
        );
    }

    /// Adds the effect on a block of places. The numbers are copied, so that the compiler knows that they do not overlap.
    #[inline(always)]
    fn add_effect_on_block<const ICE: bool>(&self, relief: &Relief, start: usize, ground_m: &[f32], e: &mut Effects) {
        let rivers = &relief.rivers;
        let spacing_m = rivers.spacing_m as f32;
        let (x, y, z) = (lanes(&e.at_m.x, start), lanes(&e.at_m.y, start), lanes(&e.at_m.z, start));
        let ground_m: Lanes<f32> = lanes(ground_m, start);
        let (mut lowest, mut highest) = (lanes(&e.lowest_m, start), lanes(&e.highest_m, start));
        let (mut river, mut stream) = (lanes(&e.river_m, start), lanes(&e.stream_m, start));
        let mut near = lanes(&e.near, start);
        // The banks of dry rivers have crumbled.
        let bank_slope = if rivers.flow == Flow::Dry { 0.06 } else { 0.5 };
        for k in 0..LANES {
            let (t, distance_m, _) = self.nearest([x[k], y[k], z[k]]);
            let half_m = self.half_width_m(t);
            let [water_m, raw_m] = self.water_m(t);
            let bank_m = distance_m - half_m;
            // Sources lie on the ground.
            let strength = if self.is_source { smooth(0.0, 0.5, t) } else { 1.0 };
            let bed_m = if ICE {
                self.ice_m(t, distance_m, half_m)
            } else {
                let inside_m = (0.6 + 0.07 * half_m) * bank_m / (half_m + 0.01);
                let outside_m = (bank_slope * bank_m).min(1.5);
                if bank_m < 0.0 { inside_m } else { outside_m }
            };
            let plain_m = if ICE { 60.0 } else { 3.0 * half_m + 15.0 };
            let side_m = (bank_m - plain_m).max(0.0);
            let slope_m = rivers.slope * side_m * side_m / (side_m + 0.12 * spacing_m);
            let far = smooth(0.1 * spacing_m, 0.75 * spacing_m, distance_m);
            let head_m = (1.0 - strength) * (60.0 + 1.2 * rivers.incision_m);
            let valley_m = water_m + bed_m + 0.01 * bank_m.max(0.0) + slope_m + head_m;
            let highest_m = valley_m + (ground_m[k] - valley_m).max(0.0) * far;
            // No dams in the sea.
            let mouth_m = if relief.has_sea { 20.0 * (3.0 - raw_m).max(0.0) } else { 0.0 };
            let lowest_m = water_m + bed_m - 0.1 * side_m - 4.0 * head_m - mouth_m - 3_000.0 * far;
            let lowest_m = if far < 1.0 { lowest_m } else { f32::MIN };
            let highest_m = if far < 1.0 { highest_m } else { f32::MAX };
            // Where two rivers meet, the lower one continues.
            let river_m = if bank_m < 0.0 { water_m } else { f32::MAX };
            lowest[k] = lowest[k].max(lowest_m);
            highest[k] = highest[k].min(highest_m);
            near[k] = near[k].max(1.0 - far);
            stream[k] = stream[k].min(bank_m);
            river[k] = river[k].min(river_m);
        }
        for (out, block) in [
            (&mut e.lowest_m, lowest),
            (&mut e.highest_m, highest),
            (&mut e.near, near),
            (&mut e.stream_m, stream),
            (&mut e.river_m, river),
        ] {
            out[start..].iter_mut().zip(block).for_each(|(out, value)| *out = value);
        }
    }
}

impl Lake {
    /// Adds the effect on the places of a cell, whose ground is given.
    fn add_effect(&self, spacing_m: f32, ground_m: &[f32], e: &mut Effects) {
        let radius_m = self.radius_m;
        let middle = self.at_m;
        // Beyond this distance from the shore, depths are not known.
        let reach_m = (0.75 * spacing_m).max(radius_m + 200.0);
        if e.distance_m(middle, [0.0; 3]) > reach_m {
            return;
        }
        for (k, ground_m) in ground_m.iter().enumerate() {
            let at = e.at_m.at(k);
            let to = minus(at, middle);
            let distance_m = dot(to, to).sqrt();
            // A basin in the middle. Around it, the ground decides where the shore is.
            let beyond_m = distance_m - 0.4 * radius_m;
            let basin_m = if beyond_m < 0.0 { 0.07 * beyond_m } else { 0.35 * beyond_m };
            let far = smooth(0.2 * spacing_m, 0.75 * spacing_m, distance_m);
            let basin_m = self.level_m + basin_m;
            // A low dam where the ground around the lake is lower than the water.
            let bank_m = distance_m - radius_m;
            let dam_m = 0.8 + if bank_m < 0.0 { 0.3 * bank_m } else { -0.07 * bank_m };
            if far < 1.0 {
                e.lowest_m[k] = e.lowest_m[k].max(self.level_m + dam_m - 3_000.0 * far);
                e.highest_m[k] = e.highest_m[k].min(basin_m + (ground_m - basin_m).max(0.0) * far);
                e.near[k] = e.near[k].max(1.0 - far);
            }
            if distance_m < reach_m && bank_m < e.shore_m[k] {
                (e.shore_m[k], e.lake_m[k]) = (bank_m, self.level_m);
            }
        }
    }
}

impl Relief {
    /// Returns true if rivers can reach any of some places.
    pub fn has_land(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) -> bool {
        self.add_continents(seed, points, 4, s, out);
        out.bed_m.iter().any(|bed_m| *bed_m > SEA_M)
    }

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
        self.add_bends(basin.seed, points, out);
        let mut effects = std::mem::take(&mut s.effects);
        let mut start = 0;
        for run in cells.chunk_by(|a, b| a == b) {
            let places = start..start + run.len();
            start = places.end;
            let in_reach = places.clone().any(|k| in_reach(out.bed_m[k]));
            if let Some(waters) = network.waters(run[0]).filter(|_| in_reach) {
                self.add_waters(&waters, points, places, &mut effects, s, out);
            }
        }
        s.effects = effects;
    }

    /// Cuts the waters of a cell into the ground of those places of a row that lie in it.
    fn add_waters(
        &self,
        waters: &Waters,
        points: &Points,
        places: std::ops::Range<usize>,
        effects: &mut Effects,
        s: &Scratch,
        out: &mut Ground,
    ) {
        let spacing_m = self.rivers.spacing_m as f32;
        let at = |k: usize| bent(points.radius_m, points.at(k), out.bend_m.at(k));
        effects.set_places(places.clone().map(|k| difference_m(waters.radius_m, waters.middle, at(k))));
        let ground_m = &out.bed_m[places.clone()];
        for channel in &waters.channels {
            match self.rivers.flow {
                Flow::Ice => channel.add_effect::<true>(self, ground_m, effects),
                Flow::Water | Flow::Dry => channel.add_effect::<false>(self, ground_m, effects),
            }
        }
        for lake in &waters.lakes {
            lake.add_effect(spacing_m, ground_m, effects);
        }
        for (i, k) in places.enumerate() {
            if self.has_sea && out.bed_m[k] <= SEA_M {
                continue;
            }
            let ground_m = out.bed_m[k];
            let (lowest_m, highest_m, near) = (effects.lowest_m[i], effects.highest_m[i], effects.near[i]);
            let (river_m, mut stream_m) = (effects.river_m[i], effects.stream_m[i]);
            let (lake_m, shore_m) = (effects.lake_m[i], effects.shore_m[i]);
            let mut bed_m = ground_m;
            let raised = if self.has_sea { smooth(-8.0, 2.0, ground_m) } else { 1.0 };
            if lowest_m > ground_m && raised > 0.0 {
                bed_m += (lowest_m - ground_m) * raised;
            }
            // Valleys keep the roughness and the layers of the ground.
            let on_bank = smooth(0.0, 60.0, stream_m.min(shore_m + 0.4 * spacing_m));
            let mut cut_m = highest_m + s.noise[k] * on_bank * near;
            if self.layer_m > 0.0 && highest_m < ground_m {
                let deep = smooth(0.0, 0.5 * self.layer_m, ground_m - highest_m);
                cut_m += (self.stepped(cut_m, s, k) - cut_m) * smooth(0.0, 120.0, stream_m) * deep;
            }
            let width_m = 12.0 * near * smooth(5.0, 200.0, stream_m.min(shore_m.max(0.0))) + 0.1;
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
                // Another river has cut a deeper valley here. This one ends at its edge: its water would be a wall in the air.
                let has_bed = river_m - surface_m < MAX_DEPTH_M - MAX_DEPTH_PER_M * stream_m;
                (surface_m, stream_m) = if has_bed { (surface_m.max(river_m), stream_m) } else { (surface_m, 0.0) };
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
    fn add_bends(&self, seed: u64, points: &Points, out: &mut Ground) {
        let Ground { bend_m, .. } = out;
        for (k, bend) in [&mut bend_m.x, &mut bend_m.y, &mut bend_m.z].into_iter().enumerate() {
            for (octave, (length, strength)) in [(0.7, 0.16), (0.22, 0.05), (0.08, 0.014)].into_iter().enumerate() {
                let frequency = points.radius_m / (length * self.rivers.spacing_m);
                let amplitude_m = (strength * self.rivers.spacing_m) as f32;
                add_noise(points, frequency, part_seed(seed, 110 + 3 * k as u32 + octave as u32), amplitude_m, bend);
            }
        }
    }
}

/// Returns a point of the unit sphere moved by a bend in metres, on a body with a radius.
pub(crate) fn bent(radius_m: f64, at: [f64; 3], bend_m: [f32; 3]) -> [f64; 3] {
    let along = |axis: usize| at[axis] + f64::from(bend_m[axis]) / radius_m;
    [along(0), along(1), along(2)]
}

#[cfg(test)]
mod tests {
    use super::super::super::points::{RADIUS_M, meridians};
    use super::super::super::surface::RowBuffers;
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

    /// Regression: where the deeper valley of another river had cut away the bed of one, its water was a wall of 160 m, as wide as the river.
    #[test]
    fn water_lies_on_its_bed() {
        let world = World::new(WorldPreset::Islands, 7);
        let (longitude, latitude) = (9.788_35f64.to_radians(), 12.146_89f64.to_radians());
        let mut row = RowBuffers::default();
        let longitudes = meridians((-30..=30).map(|k| longitude + f64::from(k) * 4.0 / RADIUS_M));
        world.ground_row(&longitudes, latitude, &mut row);
        let ground = &row.ground;
        assert!(ground.stream_m.iter().any(|stream_m| *stream_m < -5.0), "{:?}", ground.stream_m);
        for (surface_m, bed_m) in ground.surface_m.iter().zip(&ground.bed_m) {
            // The rivers here are 16 m from bank to middle at most: 3 m and a fifth of it would be 6.2 m, their beds have 1.7 m.
            assert!(surface_m - bed_m < 5.0, "water at {surface_m} m over {bed_m} m");
        }
    }
}
