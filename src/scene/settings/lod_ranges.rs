//! The distances at which tiles are replaced by their children, derived from the error in pixels. Plain values, shared by
//! culls, intersections and draws.

use glam::{DMat4, DVec2, DVec3};

/// The fraction of a level's range at which the vertices of height tiles start to morph into the coarser level.
pub(crate) const MORPH_START: f64 = 0.7;

/// The distance in metres that everything counts as if rays are parallel, since nearness then enlarges nothing. It is larger
/// than any real distance.
const PARALLEL_M: f64 = 1e10;

/// The ranges of one eye.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LodRanges {
    /// The refinement distance for each metre of geometric error.
    pub per_error: f32,
    /// The refinement distance for each metre of a range given in metres.
    pub per_metre: f32,
    /// The distance, divided by the LOD scale, at which a metre covers one pixel.
    pub per_pixel: f32,
    /// The smallest squared distance that counts.
    pub min_distance2: f32,
    is_parallel: bool,
}

impl LodRanges {
    /// Returns the ranges of an eye. `px_per_metre` is the number of pixels that one metre covers at a distance of one metre,
    /// or at any distance if rays are parallel. A tile is refined if its error, divided by the scale, exceeds `max_sse_px`.
    pub fn new(px_per_metre: f64, max_sse_px: f64, lod_scale: f64, is_parallel: bool) -> Self {
        let (per_error, per_pixel) = (px_per_metre / (max_sse_px * lod_scale), px_per_metre / lod_scale);
        let (distance_m, min_distance2) = if is_parallel { (PARALLEL_M, PARALLEL_M.powi(2)) } else { (1.0, 1e-14) };
        // The clamp keeps infinite ranges infinite under a factor of 0, and zero ranges zero under an infinite one.
        let factor = |of: f64| (of as f32).clamp(f32::MIN_POSITIVE, f32::MAX);
        Self {
            per_error: factor(per_error * distance_m),
            per_metre: factor(1.0 / lod_scale),
            per_pixel: factor(per_pixel * distance_m),
            min_distance2: min_distance2 as f32,
            is_parallel,
        }
    }

    /// Returns ranges for which distances in metres below a limit count as the limit.
    pub fn not_nearer_than(self, distance_m: f64) -> Self {
        let min_distance2 = (distance_m.max(0.0).powi(2) as f32).min(f32::MAX);
        if self.is_parallel { self } else { Self { min_distance2: self.min_distance2.max(min_distance2), ..self } }
    }

    /// Returns true if rays are parallel: the view does not depend on the eye's position along them.
    pub fn is_parallel(&self) -> bool {
        self.is_parallel
    }

    /// Returns the diameter of a sphere in pixels at a distance, divided by the LOD scale; `f64::MAX` if the eye is inside.
    /// Both lengths are metres of the same frame.
    pub fn size_px(&self, radius_m: f64, distance_m: f64) -> f64 {
        let distance_m = if self.is_parallel { PARALLEL_M } else { distance_m };
        if distance_m > radius_m { 2.0 * radius_m * f64::from(self.per_pixel) / distance_m } else { f64::MAX }
    }

    /// Returns the smallest depth of a morphed height tile whose unmorphed surface is at a depth.
    pub fn before_morph(&self, depth_m: f64) -> f64 {
        let slack = 1.0 / (MORPH_START * f64::from(self.per_error));
        if self.is_parallel { depth_m - slack * PARALLEL_M } else { depth_m * (1.0 - slack.min(0.5)) }
    }
}

/// The range test of a [`NodeKind::Lod`](crate::scene::NodeKind::Lod) or
/// [`NodeKind::LodByPixelSize`](crate::scene::NodeKind::LodByPixelSize).
#[derive(Clone, Debug)]
pub(crate) struct LodRecord {
    pub center: DVec3,
    /// The radius of a sphere whose size is compared with the ranges; `None` compares the distance.
    pub radius_m: Option<f64>,
    /// The range of each child, metres or pixels of diameter.
    pub ranges: Box<[[f64; 2]]>,
}

impl LodRecord {
    /// Returns the value that the ranges are compared with, for an eye at a distance in the node's frame.
    pub fn measure(&self, distance: f64, lod_scale: f64, ranges: &LodRanges) -> f64 {
        match self.radius_m {
            None => distance * lod_scale,
            Some(radius_m) => ranges.size_px(radius_m, distance),
        }
    }

    /// Returns the value of the nearest range, for traversals without an eye.
    pub fn nearest(&self) -> f64 {
        let starts = self.ranges.iter().map(|range| range[0]);
        match self.radius_m {
            None => starts.fold(f64::INFINITY, f64::min),
            Some(_) => starts.fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Returns true if a child is shown.
    pub fn shows(&self, child: usize, measure: f64) -> bool {
        self.ranges.get(child).is_some_and(|range| range[0] <= measure && measure < range[1])
    }
}

/// Returns the number of pixels that one metre upwards covers at a distance of one metre, or at any distance if rays are
/// parallel. The projection may turn the image.
pub(crate) fn px_per_radian(clip_from_eye: &DMat4, viewport_px: [u32; 2]) -> f64 {
    let up = clip_from_eye.y_axis.truncate().truncate();
    0.5 * (up * DVec2::from(viewport_px.map(f64::from))).length()
}

/// Returns true if a projection is not a perspective one.
pub(crate) fn has_parallel_rays(clip_from_eye: &DMat4) -> bool {
    clip_from_eye.row(3).truncate() == glam::DVec3::ZERO
}
