//! Bounds as pages store them: f32, relative to the page's origin, rounded up so that they never shrink. Plain values.

use glam::{DVec3, Vec4};

use crate::math::Aabb;

/// The half size of everything that has no usable bound. It is never culled, and finite so that no product with it is NaN.
pub(crate) const UNBOUNDED: f32 = 1.0e36;

/// The sphere of a node below which nothing can be drawn: a negative radius.
pub(super) const EMPTY_SPHERE: Vec4 = Vec4::new(0.0, 0.0, 0.0, -UNBOUNDED);
/// The sphere of a node that is never culled.
pub(super) const UNBOUNDED_SPHERE: Vec4 = Vec4::new(0.0, 0.0, 0.0, UNBOUNDED);

/// Boxes with a larger half size, in metres, are not usable bounds: a single stray vertex would otherwise keep everything
/// beside it from being culled. Ten million kilometres.
const MAX_HALF_SIZE_M: f64 = 1e10;
/// Boxes whose centre is farther from the origin of the page's frame are not usable either: there an f64 has steps of a
/// decimetre.
const MAX_CENTER_M: f64 = 1e15;

/// The boxes of four drawables, component by component, relative to the page's origin.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Boxes4 {
    pub center: [Vec4; 3],
    pub half: [Vec4; 3],
}

impl Boxes4 {
    pub(super) const EMPTY: Self = Self { center: [Vec4::ZERO; 3], half: [Vec4::ZERO; 3] };

    /// Stores the box of one of the four drawables, given in the page's frame; `None` stores an unbounded one.
    pub(super) fn set(&mut self, lane: usize, in_page: Option<&Aabb>, origin: DVec3) {
        let (center, half) = match in_page {
            Some(b) => {
                let (center, half) = (b.center() - origin, b.half_size());
                let slack = rounding_slack(center.abs().max_element() + half.max_element());
                (center.as_vec3(), (half + slack).as_vec3())
            }
            None => (glam::Vec3::ZERO, glam::Vec3::splat(UNBOUNDED)),
        };
        for axis in 0..3 {
            self.center[axis][lane] = center[axis];
            self.half[axis][lane] = half[axis];
        }
    }
}

/// Returns a sphere as f32, grown by the largest possible rounding error. The centre is relative to the page's origin.
pub(super) fn stored_sphere(center: DVec3, radius_m: f64) -> Vec4 {
    let slack = rounding_slack(center.abs().max_element() + radius_m);
    let radius_m = radius_m + slack;
    if center.is_finite() && radius_m < f64::from(UNBOUNDED) {
        center.as_vec3().extend(radius_m as f32)
    } else {
        UNBOUNDED_SPHERE
    }
}

/// Returns one f32 step at a coordinate. Measured: with it no leaf of 5 million was culled wrongly, without it one was.
fn rounding_slack(coordinate_m: f64) -> f64 {
    coordinate_m * f64::from(f32::EPSILON)
}

/// Returns true if a box is a usable bound: finite, not empty, and neither huge nor far away.
pub(super) fn is_usable(b: &Aabb) -> bool {
    !b.is_empty()
        && b.half_size().max_element() <= MAX_HALF_SIZE_M
        && b.center().abs().max_element() <= MAX_CENTER_M
        && b.min.is_finite()
        && b.max.is_finite()
}
