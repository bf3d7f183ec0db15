//! What window coordinates mean: a picture's eye, projection and viewport, and those of the pictures inside it.

use glam::{DAffine3, DMat4, DVec2, DVec3, DVec4};

use crate::math::Ray;
use crate::scene::has_parallel_rays;

/// What has less depth is ordered by its distance.
const LEAST_DEPTH: f64 = 1e-12;
/// At one of these something of every picture is in front of its near plane.
const DEPTHS: [f64; 3] = [0.5, 0.9, 0.999];

/// A camera's picture in its target.
///
/// Intersectors that are made at a place of it meet what is drawn there under other projections too: below Projection
/// nodes and below cameras with a projection or viewport of their own that draw into the same target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowView {
    /// Eye space (looking down -z, y up) to world, without scale.
    pub world_from_eye: DAffine3,
    /// Reversed-Z projection.
    pub clip_from_eye: DMat4,
    /// x, y, width and height of the picture in its target, pixels from the upper left corner.
    pub viewport_px: [u32; 4],
    /// Near and far are fitted to what is drawn and cut nothing off; else what is nearer or farther is not met below
    /// other projections.
    pub fits_depth: bool,
}

impl WindowView {
    /// True for places in the viewport.
    pub(super) fn contains(&self, at_px: DVec2) -> bool {
        let [min, max] = self.corners();
        at_px.cmpge(min).all() && at_px.cmple(max).all()
    }

    /// Upper left and lower right corner of the viewport.
    pub(super) fn corners(&self) -> [DVec2; 2] {
        let [x, y, width, height] = self.viewport_px.map(f64::from);
        [DVec2::new(x, y), DVec2::new(x + width, y + height)]
    }

    /// The point of eye space that shows at a place with a depth (1 near, 0 far); `None` where that is nowhere.
    pub(super) fn eye_at(&self, at_px: DVec2, depth: f64) -> Option<DVec3> {
        let [min, max] = self.corners();
        let share = (at_px - min) / (max - min);
        let clip = DVec4::new(2.0 * share.x - 1.0, 1.0 - 2.0 * share.y, depth, 1.0);
        let eye = self.clip_from_eye.inverse() * clip;
        let point = eye.truncate() / eye.w;
        point.is_finite().then_some(point)
    }

    /// Where a point of eye space shows, and its depth.
    pub(super) fn window_from_eye(&self, point: DVec3) -> Option<DVec3> {
        let clip = self.clip_from_eye * point.extend(1.0);
        let ndc = clip.truncate() / clip.w;
        let [min, max] = self.corners();
        let at = min + 0.5 * DVec2::new(1.0 + ndc.x, 1.0 - ndc.y) * (max - min);
        (clip.w > 0.0 && ndc.is_finite()).then(|| at.extend(ndc.z))
    }

    /// What shows at a place, in eye space: a half line of unit steps, or a segment where near and far cut something
    /// off. `all` of it begins at the eye (or beside it).
    pub(super) fn line_at(&self, at_px: DVec2, all: bool) -> Option<Ray> {
        let near = self.eye_at(at_px, 1.0)?;
        // A projection that draws before others may have its far end at any depth.
        let beyond = |depth| self.eye_at(at_px, depth).filter(|point| point.z < near.z);
        let direction = (DEPTHS.into_iter().find_map(beyond)? - near).try_normalize()?;
        let whole = Ray::infinite(near - direction * (near.z / direction.z), direction);
        if self.begins_at_eye(all) {
            return whole.is_valid().then_some(whole);
        }
        let max_ratio = beyond(0.0).map_or(f64::INFINITY, |far| near.distance(far));
        let cut = Ray { origin: near, direction, max_ratio };
        cut.is_valid().then_some(cut)
    }

    /// What shows begins at the eye's plane, wherever the near plane is: it is fitted, or, where `all` is to be met, only there
    /// because there has to be one. Parallel rays that are not fitted begin at theirs.
    pub(super) fn begins_at_eye(&self, all: bool) -> bool {
        self.fits_depth || (all && !has_parallel_rays(&self.clip_from_eye))
    }

    /// The same picture as another view has it: where a point of its eye space would be in this one, were it here at
    /// the same place and depth; and whether it lies beyond all depths, as it may where they are fitted.
    pub(super) fn eye_of_other(&self, other: &Self, point: DVec3) -> Option<(DVec3, bool)> {
        let window = other.window_from_eye(point)?;
        let there = self.eye_at(window.truncate(), window.z.max(LEAST_DEPTH))?;
        Some((there, window.z < LEAST_DEPTH))
    }
}
