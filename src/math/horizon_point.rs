//! [`horizon_point`]: a point that stands for a part of a body's surface in the test against the horizon. Arithmetic.

use glam::DVec3;

use super::{Geodetic, Region};

/// The number of steps along each side of a region at which its surface is sampled.
const STEPS: u32 = 8;
/// The least cosine of the angle between the direction of the point and the tangent through the farthest sample. A point
/// would be more than ten radii away otherwise.
const MIN_COS: f64 = 0.1;
/// Share by which the point is moved outwards, for values that are stored as f32.
const ROUNDING: f64 = 1e-6;

/// Returns a point in ECEF metres which is behind the horizon only if everything in the region is. `None` for a region that
/// is too large or invalid.
///
/// In space scaled by the radii the body is the unit sphere. A tangent through a sample at the angle `alpha` from the
/// direction of the point, and at the height that has the angle `beta` to its horizon, meets that direction at the distance
/// `1 / cos(alpha + beta)` (D. Bagnell and K. Ring, "Computing the horizon occlusion point", cesium.com/blog, 2013). Bodies
/// that are larger than the one assumed here hide more.
pub(crate) fn horizon_point(region: &Region) -> Option<DVec3> {
    let body = region.ellipsoid;
    // No horizon is computed with a smaller body.
    let [lowest_m, _] = body.ground_m();
    let radii = body.radii_m() + lowest_m;
    let (width, height) = (region.width(), region.north - region.south);
    let scaled = |x: f64, y: f64| {
        let longitude = region.west + width * x;
        let latitude = region.south + height * y;
        body.ecef(&Geodetic { longitude, latitude, height_m: region.max_height_m }) / radii
    };
    let direction = scaled(0.5, 0.5).normalize();
    let share = |step: u32| f64::from(step) / f64::from(STEPS);
    let samples = (0..=STEPS).flat_map(|i| (0..=STEPS).map(move |j| (i, j)));
    // Between two samples the surface is farther from the direction by at most the sagitta of a step.
    let step = width.max(height) / f64::from(STEPS);
    let farthest = samples.map(|(i, j)| {
        let point = scaled(share(i), share(j));
        let alpha = direction.cross(point).length().atan2(direction.dot(point)) + step * step / 8.0;
        alpha + point.length().max(1.0).recip().acos()
    });
    let cos = farthest.fold(0.0, f64::max).cos();
    (cos >= MIN_COS && direction.is_finite()).then(|| direction * radii * ((1.0 + ROUNDING) / cos))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::WGS84;

    fn region(degrees: [f64; 4], max_height_m: f64) -> Region {
        let [west, south, east, north] = degrees.map(f64::to_radians);
        Region { west, south, east, north, min_height_m: -100.0, max_height_m, ellipsoid: WGS84 }
    }

    #[test]
    fn point_is_above_the_middle_and_the_higher_the_larger_the_region() {
        let mut last_m = 0.0;
        for side in [0.1, 1.0, 10.0, 40.0] {
            let region = region([7.0, 46.0, 7.0 + side, 46.0 + side], 3000.0);
            let point = WGS84.geodetic(horizon_point(&region).unwrap());
            assert!((point.longitude - region.center().longitude).abs() < 1e-9, "{point:?}");
            assert!((point.latitude - region.center().latitude).abs() < 0.01, "{point:?}");
            assert!(point.height_m > 3000.0 && point.height_m > last_m, "{point:?}");
            last_m = point.height_m;
        }
        for degrees in [[-180.0, -90.0, 0.0, 90.0], [-180.0, -10.0, 180.0, 10.0], [0.0, f64::NAN, 1.0, 1.0]] {
            assert_eq!(horizon_point(&region(degrees, 0.0)), None);
        }
    }
}
