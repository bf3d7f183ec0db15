//! The distances at which tiles give way to their children, by the error they have in pixels. Plain values, shared by cull,
//! intersections and draw.

use glam::{DMat4, DVec2, DVec3};

/// Share of a level's range at which the vertices of height tiles start to morph into the coarser level.
pub(crate) const MORPH_START: f64 = 0.7;

/// Where rays are parallel nothing is seen larger for being near: all counts as so far away, in metres, which is farther
/// than anything is.
const PARALLEL_M: f64 = 1e10;

/// Ranges of one eye.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LodRanges {
    /// Of a metre of geometric error.
    pub per_error: f32,
    /// Of a metre of a range that is said in metres.
    pub per_metre: f32,
    /// Of a metre that shall cover a pixel, over the LOD scale.
    pub per_pixel: f32,
    /// The squared distance from which an error is seen at least.
    pub min_distance2: f32,
    is_parallel: bool,
}

impl LodRanges {
    /// Ranges of an eye for which one metre covers so many pixels: at a distance of one metre, or at all where its rays are
    /// parallel. A tile is refined where its error, over the scale, is more than `max_sse_px`.
    pub fn new(px_per_metre: f64, max_sse_px: f64, lod_scale: f64, is_parallel: bool) -> Self {
        let (per_error, per_pixel) = (px_per_metre / (max_sse_px * lod_scale), px_per_metre / lod_scale);
        let (distance_m, min_distance2) = if is_parallel { (PARALLEL_M, PARALLEL_M.powi(2)) } else { (1.0, 1e-14) };
        // Endless ranges stay so under a factor of 0, and what has none under an endless one.
        let factor = |of: f64| (of as f32).clamp(f32::MIN_POSITIVE, f32::MAX);
        Self {
            per_error: factor(per_error * distance_m),
            per_metre: factor(1.0 / lod_scale),
            per_pixel: factor(per_pixel * distance_m),
            min_distance2: min_distance2 as f32,
            is_parallel,
        }
    }

    /// Rays are parallel: what is seen does not depend on where along them the eye is.
    pub fn is_parallel(&self) -> bool {
        self.is_parallel
    }

    /// Pixels that a sphere covers across, over the LOD scale, at a distance; no end of them around the eye. Metres of one
    /// frame.
    pub fn size_px(&self, radius_m: f64, distance_m: f64) -> f64 {
        let distance_m = if self.is_parallel { PARALLEL_M } else { distance_m };
        if distance_m > radius_m { 2.0 * radius_m * f64::from(self.per_pixel) / distance_m } else { f64::MAX }
    }

    /// The least depth at which a height tile can lie whose own surface is at a depth, as far as it may have morphed.
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
    /// Of the sphere whose size counts instead of its distance.
    pub radius_m: Option<f64>,
    /// Metres, or pixels across.
    pub ranges: Box<[[f64; 2]]>,
}

impl LodRecord {
    /// What the ranges are compared with, for an eye at a distance in the node's frame.
    pub fn measure(&self, distance: f64, lod_scale: f64, ranges: &LodRanges) -> f64 {
        match self.radius_m {
            None => distance * lod_scale,
            Some(radius_m) => ranges.size_px(radius_m, distance),
        }
    }

    /// The same where no eye decides, as if it were as near as can be.
    pub fn nearest(&self) -> f64 {
        let starts = self.ranges.iter().map(|range| range[0]);
        match self.radius_m {
            None => starts.fold(f64::INFINITY, f64::min),
            Some(_) => starts.fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Whether a child is shown.
    pub fn shows(&self, child: usize, measure: f64) -> bool {
        self.ranges.get(child).is_some_and(|range| range[0] <= measure && measure < range[1])
    }
}

/// Pixels that one metre upwards covers at a distance of one metre, or, where rays are parallel, at any; a projection may
/// turn the picture.
pub(crate) fn px_per_radian(clip_from_eye: &DMat4, viewport_px: [u32; 2]) -> f64 {
    let up = clip_from_eye.y_axis.truncate().truncate();
    0.5 * (up * DVec2::from(viewport_px.map(f64::from))).length()
}

/// True for projections that are not perspective.
pub(crate) fn has_parallel_rays(clip_from_eye: &DMat4) -> bool {
    clip_from_eye.row(3).truncate() == glam::DVec3::ZERO
}
