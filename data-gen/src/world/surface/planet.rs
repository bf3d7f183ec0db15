//! A world: rows of heights and of all properties of the ground, from a preset and a seed.

use terrane::math::{Ellipsoid, WGS84};

use super::super::points::{Meridian, Points, RADIUS_M, meridians, sin_cos};
use super::super::preset::{Flow, Parameters, WorldPreset};
use super::super::relief::{Basin, Drainage, Ground, Network, Scratch};
use super::climate::{FROZEN_C, WINDWARD_M, Weather};
use super::patch_lattice::{Lattice, MARGIN};

/// The equatorial radii of bodies with worlds in metres.
const RADII_M: std::ops::RangeInclusive<f64> = 1e4..=2e7;
/// The distance between samples, in distances of rivers, from which on there are no rivers.
const MAX_STEP: f64 = 0.5;

/// A planet made from a preset and a seed. Everything about a position depends on these and on the position only.
#[derive(Clone, Debug)]
pub struct World {
    pub(in crate::world) seed: u64,
    pub(in crate::world) parameters: Parameters,
    /// The ellipsoid that tiles lie on.
    pub(in crate::world) ellipsoid: Ellipsoid,
    drainage: Drainage,
}

/// Buffers for rows. Each thread has its own.
#[derive(Clone, Debug, Default)]
pub(in crate::world) struct RowBuffers {
    points: Points,
    scratch: Scratch,
    pub network: Network,
    pub ground: Ground,
}

impl World {
    /// Creates a world of the size of the earth.
    pub fn new(preset: WorldPreset, seed: u64) -> Self {
        Self::on(preset, seed, WGS84)
    }

    /// Creates a world on a body. Mountains, rivers and craters are as large as on the earth.
    pub fn on(preset: WorldPreset, seed: u64, ellipsoid: Ellipsoid) -> Self {
        let parameters = preset.parameters();
        let drainage = Drainage::new(parameters.relief.rivers.spacing_m.max(1_000.0), radius_of(&ellipsoid));
        Self { seed, parameters, ellipsoid, drainage }
    }

    /// Returns true for bodies on which worlds can be made. On larger ones the numbers of noise cells overflow.
    pub fn can_lie_on(ellipsoid: &Ellipsoid) -> bool {
        RADII_M.contains(&ellipsoid.semi_major_m)
    }

    /// Returns the radius in metres of the sphere that the noise is sampled on.
    pub(in crate::world) fn radius_m(&self) -> f64 {
        radius_of(&self.ellipsoid)
    }

    /// Returns the meridians of longitudes some way against the wind.
    pub(in crate::world) fn windward(&self, longitudes: impl Iterator<Item = f64>) -> Vec<Meridian> {
        let step = WINDWARD_M / self.radius_m();
        meridians(longitudes.map(|longitude| longitude + step))
    }

    /// Returns the longitude and latitude in radians of a place with much relief around the preset's place, for a square
    /// with sides in metres.
    pub fn place(&self, size_m: f64) -> [f64; 2] {
        let [longitude, latitude] = self.parameters.place.map(f64::to_radians);
        let mut row = RowBuffers::default();
        let step = (0.7 * size_m / self.radius_m()).max(0.004);
        let places = (-6..=6).flat_map(|j| (-8..=8).map(move |i| (i, j)));
        let mut best = (f32::MIN, [longitude, latitude]);
        for (i, j) in places {
            let here = [longitude + step * f64::from(i), latitude + step * f64::from(j)];
            let side = size_m / self.radius_m();
            let longitudes = meridians((-4..=4).map(|k| here[0] + side * f64::from(k) / 8.0));
            let (mut uneven, mut land) = (0.0f32, 0.0f32);
            for k in [-2, 0, 2] {
                self.ground_row(&longitudes, here[1] + side * f64::from(k) / 8.0, &mut row);
                let heights = &row.ground.surface_m;
                uneven += heights.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f32>();
                land += row.ground.depth_m.iter().filter(|depth| **depth < 0.0).count() as f32 / 27.0;
            }
            // A coast in the picture is better than land alone.
            let score = uneven * if (0.25..0.8).contains(&land) { 3.0 } else { 1.0 };
            if score > best.0 {
                best = (score, here);
            }
        }
        best.1
    }

    pub(in crate::world) fn basin(&self) -> Basin<'_> {
        Basin { relief: &self.parameters.relief, drainage: &self.drainage, seed: self.seed }
    }

    /// Computes the ground of a row.
    pub(in crate::world) fn ground_row(&self, meridians: &[Meridian], latitude: f64, row: &mut RowBuffers) {
        self.set_points(meridians, latitude, row);
        let relief = &self.parameters.relief;
        relief.row(self.basin(), &row.points, &mut row.network, &mut row.scratch, &mut row.ground);
    }

    fn set_points(&self, meridians: &[Meridian], latitude: f64, row: &mut RowBuffers) {
        row.points.radius_m = self.radius_m();
        row.points.set_row(meridians, latitude);
    }

    /// Returns true if there is open water anywhere.
    pub(in crate::world) fn has_water(&self) -> bool {
        self.parameters.climate.has_life && self.parameters.relief.rivers.flow != Flow::Dry
    }

    /// Returns true if most of the sea at a latitude is ice.
    pub(in crate::world) fn is_sea_frozen(&self, latitude: f64) -> bool {
        self.parameters.climate.mean_c(sin_cos(latitude).0.abs() as f32) < FROZEN_C
    }

    /// Returns true if samples that are some metres apart show rivers and lakes.
    pub(in crate::world) fn has_rivers(&self, step_m: f64) -> bool {
        self.parameters.relief.rivers.spacing_m <= 0.0 || step_m < MAX_STEP * self.drainage.spacing_m()
    }

    /// Computes the ground of a row of samples that are some metres apart, without rivers and lakes where these are closer
    /// than [`MAX_STEP`]: each sample would need a network of its own, and a cell could not show what it finds.
    pub(in crate::world) fn ground_row_of(
        &self,
        meridians: &[Meridian],
        latitude: f64,
        step_m: f64,
        row: &mut RowBuffers,
    ) {
        if self.has_rivers(step_m) {
            return self.ground_row(meridians, latitude, row);
        }
        self.set_points(meridians, latitude, row);
        self.parameters.relief.dry_row(self.seed, &row.points, &mut row.scratch, &mut row.ground);
    }

    /// Finds the rivers and lakes of a patch of `cells` cells along a side. Rows that need more of them find these themselves.
    pub(in crate::world) fn find_rivers(&self, lattice: &Lattice, cells: usize, row: &mut RowBuffers) {
        let spacing_m = self.drainage.spacing_m();
        let relief = &self.parameters.relief;
        if relief.rivers.spacing_m <= 0.0 || !self.has_rivers(lattice.step_m()) {
            return;
        }
        // A few places show whether there is land.
        let (first, last) = (-(MARGIN as i64), (cells + MARGIN) as i64);
        let every = |step: i64| (first..last).step_by(step as usize).chain(std::iter::once(last));
        let is_land = |latitude: f64, row: &mut RowBuffers| {
            let longitudes = meridians(every(8).map(|column| lattice.longitude(column)));
            self.set_points(&longitudes, latitude, row);
            relief.has_land(self.seed, &row.points, &mut row.scratch, &mut row.ground)
        };
        if relief.has_sea && !every(8).any(|j| is_land(lattice.latitude(j), row)) {
            return;
        }
        // No cell lies between two of these places.
        let step = ((0.4 * spacing_m / lattice.step_m()) as i64).clamp(1, last - first);
        let places = every(step).flat_map(|j| every(step).map(move |i| (i, j)));
        let mut found: Vec<_> =
            places.map(|(i, j)| self.drainage.cell(lattice.longitude(i), lattice.latitude(j))).collect();
        found.sort_unstable();
        found.dedup();
        row.network.prepare(self.basin(), &found);
    }

    /// Computes the climate of a row from its ground; `windward` are meridians some way against the wind.
    pub(in crate::world) fn weather_row(
        &self,
        points: &Points,
        windward: &[Meridian],
        latitude: f64,
        ground: &Ground,
        row: &mut RowBuffers,
        out: &mut Weather,
    ) {
        self.set_points(windward, latitude, row);
        self.parameters.relief.mountain_row(self.seed, &row.points, &mut row.scratch, &mut row.ground);
        self.parameters.climate.row(self.seed, points, ground, &row.ground, out);
    }
}

/// Returns the radius of the sphere of a body in metres.
fn radius_of(ellipsoid: &Ellipsoid) -> f64 {
    RADIUS_M * (ellipsoid.semi_major_m / WGS84.semi_major_m)
}
