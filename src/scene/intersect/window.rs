//! Window coordinates: the eye, projection and viewport of an image, and conversions between the views drawn into it.

use glam::{DAffine3, DMat4, DVec2, DVec3, DVec4};

use crate::math::Ray;
use crate::scene::has_parallel_rays;

/// Points with a smaller depth are ordered by their distance.
const MIN_DEPTH: f64 = 1e-12;
/// Depths to try for a point beyond the near plane; every projection has one at some of them.
const DEPTHS: [f64; 3] = [0.5, 0.9, 0.999];

/// The image of a camera in its target.
///
/// Intersectors created at a position of the image also meet geometry drawn there with other projections. Such geometry is
/// below Projection nodes, or below cameras with a separate projection or viewport that draw into the same target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowView {
    /// Maps eye space (looking down -z, y up) to the world, without scale.
    pub world_from_eye: DAffine3,
    /// The reversed-Z projection.
    pub clip_from_eye: DMat4,
    /// x, y, width and height of the image in its target, pixels from the upper left corner.
    pub viewport_px: [u32; 4],
    /// True if near and far are fitted to the drawn geometry and clip nothing. Otherwise geometry outside their range is not
    /// met below other projections.
    pub fits_depth: bool,
}

impl WindowView {
    /// Returns true if a point is in the viewport.
    pub(super) fn contains(&self, at_px: DVec2) -> bool {
        let [min, max] = self.corners();
        at_px.cmpge(min).all() && at_px.cmple(max).all()
    }

    /// Returns the upper left and lower right corner of the viewport.
    pub(super) fn corners(&self) -> [DVec2; 2] {
        let [x, y, width, height] = self.viewport_px.map(f64::from);
        [DVec2::new(x, y), DVec2::new(x + width, y + height)]
    }

    /// Returns the point of eye space at an image position and depth (1 near, 0 far); `None` if it is not finite.
    pub(super) fn eye_at(&self, at_px: DVec2, depth: f64) -> Option<DVec3> {
        let [min, max] = self.corners();
        let share = (at_px - min) / (max - min);
        let clip = DVec4::new(2.0 * share.x - 1.0, 1.0 - 2.0 * share.y, depth, 1.0);
        let eye = self.clip_from_eye.inverse() * clip;
        let point = eye.truncate() / eye.w;
        point.is_finite().then_some(point)
    }

    /// Returns the image position and depth of a point of eye space; `None` behind the eye.
    pub(super) fn window_from_eye(&self, point: DVec3) -> Option<DVec3> {
        let clip = self.clip_from_eye * point.extend(1.0);
        let ndc = clip.truncate() / clip.w;
        let [min, max] = self.corners();
        let at = min + 0.5 * DVec2::new(1.0 + ndc.x, 1.0 - ndc.y) * (max - min);
        (clip.w > 0.0 && ndc.is_finite()).then(|| at.extend(ndc.z))
    }

    /// Returns the line of eye space that is visible at an image position: a ray with a unit direction, or a segment if near and
    /// far clip. If `all`, it begins at the eye's plane.
    pub(super) fn line_at(&self, at_px: DVec2, all: bool) -> Option<Ray> {
        let near = self.eye_at(at_px, 1.0)?;
        // A background projection may have its far end at any depth.
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

    /// Returns true if lines begin at the eye's plane instead of the near plane. They do if near is fitted, or if `all` is set
    /// and the projection is perspective. Parallel rays that are not fitted begin at the near plane.
    pub(super) fn begins_at_eye(&self, all: bool) -> bool {
        self.fits_depth || (all && !has_parallel_rays(&self.clip_from_eye))
    }

    /// Converts a point of another view's eye space to the point of this one at the same image position and depth. Also returns
    /// true if the point is beyond the far plane, which is possible while depths are fitted.
    pub(super) fn eye_of_other(&self, other: &Self, point: DVec3) -> Option<(DVec3, bool)> {
        let window = other.window_from_eye(point)?;
        let there = self.eye_at(window.truncate(), window.z.max(MIN_DEPTH))?;
        Some((there, window.z < MIN_DEPTH))
    }
}
