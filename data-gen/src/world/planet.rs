//! A world: rows of heights and of all properties of the ground, from a preset and a seed.

use super::climate::{WINDWARD, Weather};
use super::points::{Points, RADIUS_M, sin_cos};
use super::preset::{Parameters, WorldPreset};
use super::relief::{Ground, Scratch};

/// A planet made from a preset and a seed. Everything about a position depends on these and on the position only.
#[derive(Clone, Debug)]
pub struct World {
    pub(super) seed: u64,
    pub(super) parameters: Parameters,
}

/// Buffers for rows. Each thread has its own.
#[derive(Clone, Debug, Default)]
pub(super) struct RowBuffers {
    points: Points,
    scratch: Scratch,
    pub ground: Ground,
}

impl World {
    /// Creates a world.
    pub fn new(preset: WorldPreset, seed: u64) -> Self {
        Self { seed, parameters: preset.parameters() }
    }

    /// Returns the longitude and latitude in radians of a place with much relief around the preset's place, for a square
    /// with sides in metres.
    pub fn place(&self, size_m: f64) -> [f64; 2] {
        let [longitude, latitude] = self.parameters.place.map(f64::to_radians);
        let mut row = RowBuffers::default();
        let step = (0.7 * size_m / RADIUS_M).max(0.004);
        let places = (-6..=6).flat_map(|j| (-8..=8).map(move |i| (i, j)));
        let mut best = (f32::MIN, [longitude, latitude]);
        for (i, j) in places {
            let here = [longitude + step * f64::from(i), latitude + step * f64::from(j)];
            let side = size_m / RADIUS_M;
            let longitudes = meridians((-4..=4).map(|k| here[0] + side * f64::from(k) / 8.0));
            let (mut uneven, mut land) = (0.0f32, 0.0f32);
            for k in [-2, 0, 2] {
                self.ground_row(&longitudes, here[1] + side * f64::from(k) / 8.0, &mut row);
                let heights = row.ground.bed_m.iter().map(|bed| bed.max(self.water_m()));
                let heights: Vec<f32> = heights.collect();
                uneven += heights.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f32>();
                land += row.ground.bed_m.iter().filter(|bed| **bed > self.water_m()).count() as f32 / 27.0;
            }
            // A coast in the picture is better than land alone.
            let score = uneven * if (0.25..0.8).contains(&land) { 3.0 } else { 1.0 };
            if score > best.0 {
                best = (score, here);
            }
        }
        best.1
    }

    /// Returns the height of the water in metres; none is below all ground.
    pub(super) fn water_m(&self) -> f32 {
        if self.parameters.relief.has_sea { 0.0 } else { f32::MIN }
    }

    /// Computes the ground of a row.
    pub(super) fn ground_row(&self, meridians: &[(f64, f64)], latitude: f64, row: &mut RowBuffers) {
        row.points.set_row(meridians, latitude);
        self.parameters.relief.row(self.seed, &row.points, &mut row.scratch, &mut row.ground);
    }

    /// Computes the climate of a row from its ground; `windward` are meridians some way against the wind.
    pub(super) fn weather_row(
        &self,
        points: &Points,
        windward: &[(f64, f64)],
        latitude: f64,
        ground: &Ground,
        row: &mut RowBuffers,
        out: &mut Weather,
    ) {
        row.points.set_row(windward, latitude);
        self.parameters.relief.mountain_row(self.seed, &row.points, &mut row.scratch, &mut row.ground);
        self.parameters.climate.row(self.seed, points, ground, &row.ground, out);
    }
}

/// Returns the sines and cosines of longitudes.
pub(super) fn meridians(longitudes: impl Iterator<Item = f64>) -> Vec<(f64, f64)> {
    longitudes.map(sin_cos).collect()
}

/// Returns the sines and cosines of longitudes some way against the wind.
pub(super) fn windward(longitudes: impl Iterator<Item = f64>) -> Vec<(f64, f64)> {
    meridians(longitudes.map(|longitude| longitude + WINDWARD))
}
