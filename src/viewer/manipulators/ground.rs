//! [`SceneGround`]: ground heights from the loaded scene; and the level ground that terrain gestures hold on to.

use std::cell::RefCell;

use glam::DVec3;

use super::manipulator::{GroundHeight, ManipulatorView};
use crate::math::Ellipsoid;
use crate::scene::{IntersectionLimit, IntersectionVisitor, LineSegmentIntersector, Scene};

/// Points farther from the origin than this are in body-centred coordinates, equatorial radii: 1,000 km on the earth.
const BODY_CENTRED_BEYOND: f64 = 1.0e6 / 6_378_137.0;

/// Takes the ground from the scene: the highest intersection below or above a point, at the finest loaded level.
///
/// It needs tiles read with [`PagerConfig::build_kd_trees`](crate::pager::PagerConfig::build_kd_trees); others are not
/// found.
#[derive(Debug, Default)]
pub struct SceneGround {
    /// Kept to reuse its memory.
    visitor: RefCell<IntersectionVisitor>,
}

impl SceneGround {
    /// Ignores nodes whose masks have none of these bits.
    pub fn with_traversal_mask(self, mask: u32) -> Self {
        self.visitor.borrow_mut().traversal_mask = mask;
        self
    }
}

impl GroundHeight for SceneGround {
    fn ground_at(&self, scene: &Scene, point: DVec3, up: DVec3) -> Option<DVec3> {
        let all = scene.bounding_sphere();
        let start = point + up * ((all.center - point).dot(up) + all.radius_m);
        let ellipsoid = scene.ellipsoid();
        let down_m = if point.length() > BODY_CENTRED_BEYOND * ellipsoid.semi_major_m {
            // The segment must not reach the other side of the body.
            let [lowest_m, _] = ellipsoid.ground_m();
            (ellipsoid.geodetic(start).height_m - 2.0 * lowest_m).min(2.0 * all.radius_m)
        } else {
            2.0 * all.radius_m
        };
        if !(start.is_finite() && down_m > 0.0) {
            return None;
        }
        let segment = LineSegmentIntersector::new(start, start - up * down_m);
        let mut segment = segment.with_limit(IntersectionLimit::Nearest);
        self.visitor.try_borrow_mut().ok()?.traverse(scene, &mut segment);
        segment.first_intersection().map(|met| met.world_point())
    }
}

/// Returns the point where a ray descends to the level of `level`: to the horizontal plane through it, or to the ellipsoid
/// at its height. `None` when the ray passes above.
pub(super) fn intersect_level(view: &ManipulatorView<'_>, level: DVec3, eye: DVec3, direction: DVec3) -> Option<DVec3> {
    let distance_m = if let Some(ellipsoid) = view.frame_at(level).ellipsoid {
        let height_m = ellipsoid.geodetic(level).height_m;
        let Ellipsoid { semi_major_m, semi_minor_m } = ellipsoid;
        let (major_m, minor_m) = (semi_major_m + height_m, semi_minor_m + height_m);
        if !(major_m > 0.0 && minor_m > 0.0) {
            return None;
        }
        // Stretching along the polar axis turns the ellipsoid into a sphere.
        let stretch = DVec3::new(1.0, 1.0, major_m / minor_m);
        let (eye, direction) = (eye * stretch, direction * stretch);
        let (down, above) = (-eye.dot(direction), eye.length_squared() - major_m * major_m);
        let root = (down * down - direction.length_squared() * above).sqrt();
        above / (down + root)
    } else {
        (level.z - eye.z) / direction.z
    };
    let met = eye + direction * distance_m;
    (distance_m >= 0.0 && met.is_finite()).then_some(met)
}
