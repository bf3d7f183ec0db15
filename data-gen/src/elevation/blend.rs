//! The bands along the edges of rasters in which overlapping ones blend into each other.

use super::nearby::Nearby;
use super::raster::{Raster, SamplePosition};

/// Mean radius of the earth, to convert angles to metres. A band needs no ellipsoid.
const RADIUS_M: f64 = 6_371_000.0;
/// Neighbours whose pixels differ by at most this factor belong to one grid.
const MAX_RATIO: f64 = 1.5;

/// The bands along the edges of rasters.
pub(super) struct Edges {
    blend_m: f64,
    /// The width and height of each raster's pixels in metres.
    pixels_m: Vec<[f64; 2]>,
}

impl Edges {
    pub fn new(rasters: &[Raster], blend_m: f64) -> Self {
        let pixel_m = |raster: &Raster| {
            let ([_, south, _, north], [dx, dy]) = (raster.bounds(), raster.sample_distance());
            [dx * RADIUS_M * (0.5 * (south + north)).cos(), dy * RADIUS_M]
        };
        Self { blend_m, pixels_m: rasters.iter().map(pixel_m).collect() }
    }

    /// Returns the share of a raster in the height at a position that it covers: 1 away from its edges, and 0 on an edge. An
    /// edge at which a neighbour of the same grid continues the raster does not count.
    pub fn share(&self, rasters: &[Raster], nearby: &Nearby, raster: usize, position: &SamplePosition) -> f64 {
        let [width, height] = rasters[raster].size().map(|side| side as i64 - 1);
        let [x, y] = position.nearest_px;
        let [wide_m, high_m] = self.pixels_m[raster];
        let [column, row] = [(x.round() as i64).clamp(0, width), (y.round() as i64).clamp(0, height)];
        // The distance from each edge, and the samples nearest to it: one beyond it, and one some pixels inside.
        let sides = [
            (x * wide_m, [-1, row], [width.min(3), row]),
            ((width as f64 - x) * wide_m, [width + 1, row], [(width - 3).max(0), row]),
            (y * high_m, [column, -1], [column, height.min(3)]),
            ((height as f64 - y) * high_m, [column, height + 1], [column, (height - 3).max(0)]),
        ];
        let skipped = if rasters[raster].around().is_some() { 2 } else { 0 };
        let mut far_m = f64::INFINITY;
        for (edge_m, beyond, inside) in &sides[skipped..] {
            if *edge_m < far_m.min(self.blend_m) && !self.is_continued(rasters, nearby, raster, *beyond, *inside) {
                far_m = edge_m.max(0.0);
            }
        }
        let t = (far_m / self.blend_m).min(1.0);
        t * t * (3.0 - 2.0 * t)
    }

    /// Returns true if another raster with pixels of about the same size begins where this one ends: it covers a position beyond
    /// the edge and none inside of it.
    fn is_continued(
        &self,
        rasters: &[Raster],
        nearby: &Nearby,
        raster: usize,
        beyond: [i64; 2],
        inside: [i64; 2],
    ) -> bool {
        let covers = |other: &Raster, [longitude, latitude]: [f64; 2]| {
            other.locate(longitude, latitude).is_some_and(|position| position.is_covered())
        };
        let [beyond, inside] = [beyond, inside].map(|[column, row]| rasters[raster].position(column, row));
        let is_alike = |other: usize| {
            let ratio = self.pixels_m[other][1] / self.pixels_m[raster][1];
            (MAX_RATIO.recip()..=MAX_RATIO).contains(&ratio)
        };
        let mut others = nearby.at(beyond[0], beyond[1]).filter(|other| *other != raster && is_alike(*other));
        others.any(|other| covers(&rasters[other], beyond) && !covers(&rasters[other], inside))
    }
}

/// Heights at one position, from the upper ones to the lower ones.
#[derive(Default)]
pub(super) struct Blend {
    first_m: Option<f64>,
    /// The sum of the heights by their weights, and of the weights.
    sum_m: f64,
    weights: f64,
    /// The part that is left for lower heights.
    left: f64,
    count: usize,
}

impl Blend {
    /// Adds a height with a share of what is left.
    pub fn add(&mut self, height_m: f64, share: f64) {
        let left = if self.count == 0 { 1.0 } else { self.left };
        self.first_m.get_or_insert(height_m);
        self.sum_m += left * share * height_m;
        self.weights += left * share;
        self.left = left * (1.0 - share);
        self.count += 1;
    }

    /// Returns true if lower heights do not count.
    pub fn is_full(&self) -> bool {
        self.count > 0 && self.left <= 0.0
    }

    /// Returns the height; `None` if none was added.
    pub fn height_m(&self) -> Option<f64> {
        match self.count > 1 && self.weights > 1e-9 {
            true => Some(self.sum_m / self.weights),
            false => self.first_m,
        }
    }
}
