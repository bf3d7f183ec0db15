//! Tests a large tile of a globe's surface by its parts: its box may be in sight although no part of the surface is. The box of a
//! tile reaches above its middle and beside its narrow end. Culling thread.

use glam::{DVec3, Vec3};

use super::horizon::Horizon;
use crate::cull::views::Planes;
use crate::math::{PartTest, Region, SurfacePart};

/// Returns true if each part of a region is outside of a side plane in `mask`, or behind the horizon. `eye` is in ECEF metres, as the
/// frame of the planes is.
pub(super) fn is_out_of_sight(region: &Region, eye: DVec3, (planes, mask): (&Planes, u8), horizon: &Horizon) -> bool {
    SurfacePart::all(region, |part| {
        let offsets = part.corners.map(|corner| (corner - eye).as_vec3());
        let reach_m = part.reach_m as f32;
        // The space outside of a plane is convex, and so is the cone behind the horizon: they hold the hull of the corners.
        if planes.spheres_are_outside(&offsets, reach_m, mask)
            || offsets.iter().all(|offset| horizon.hides(offset.to_array(), reach_m))
        {
            return PartTest::Holds;
        }
        let is_seen =
            |offset: Vec3| !planes.spheres_are_outside(&[offset], 0.0, mask) && !horizon.hides(offset.to_array(), 0.0);
        if offsets.into_iter().any(is_seen) { PartTest::Fails } else { PartTest::Unsure }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cull::views::EyePlanes;
    use crate::math::{Geodetic, WGS84, horizon_point};
    use crate::scene::CullingMode;
    use glam::DAffine3;
    use glam::dcamera::rh::proj::directx::perspective_infinite_reverse;
    use glam::dcamera::rh::view::look_to_mat4;
    use proptest::prelude::*;

    const SIDE_TAN: f64 = 0.6;

    fn position(longitude: f64, latitude: f64, height_m: f64) -> DVec3 {
        WGS84.ecef(&Geodetic { longitude, latitude, height_m })
    }

    /// Returns true if the line from the eye to a point meets the ellipsoid before it.
    fn is_hidden(eye: DVec3, point: DVec3) -> bool {
        let shrink = WGS84.radii_m().recip();
        let (from, to) = (eye * shrink, (point - eye) * shrink);
        let nearest = (-from.dot(to) / to.length_squared()).clamp(0.0, 1.0);
        nearest < 1.0 && (from + to * nearest).length_squared() < 1.0
    }

    proptest! {
        /// No point of a tile that is culled is in sight.
        #[test]
        fn tiles_that_are_culled_are_not_seen(
            (longitude, latitude) in (-3.1..3.1f64, -1.57..1.57f64),
            height in 3.0..7.3f64,
            (heading, pitch) in (-3.1..3.1f64, -1.57..0.2f64),
            (level, x, y) in (1..8i32, 0.0..1.0f64, 0.0..1.0f64),
            highest_m in 0.0..9000.0f64,
        ) {
            let eye = position(longitude, latitude, 10f64.powf(height));
            let eye_from_enu = DAffine3::from_rotation_x(-std::f64::consts::FRAC_PI_2 - pitch) * DAffine3::from_rotation_z(heading);
            let enu_from_ecef = WGS84.ecef_from_enu(&WGS84.geodetic(eye)).inverse();
            let eye_from_ecef = eye_from_enu * enu_from_ecef;
            let clip = perspective_infinite_reverse(2.0 * SIDE_TAN.atan(), 1.5, 1.0);
            let planes = EyePlanes::new(&clip, CullingMode::default()).in_frame(&eye_from_ecef, eye);
            let Some(horizon) = Horizon::new(&WGS84, &DAffine3::IDENTITY, eye) else { return Ok(()) };
            // A tile of the geographic tiling.
            let size = std::f64::consts::PI / 2f64.powi(level);
            let west = (x * 2.0 * 2f64.powi(level)).floor() * size - std::f64::consts::PI;
            let south = (y * 2f64.powi(level)).floor() * size - std::f64::consts::FRAC_PI_2;
            let region = Region {
                west, south, east: west + size, north: south + size, min_height_m: -100.0, max_height_m: highest_m, ellipsoid: WGS84,
            };
            let culled = is_out_of_sight(&region, eye, (&planes, 0b1111), &horizon);
            let share = |i: u32| f64::from(i) / 24.0 * size;
            let is_seen = |point: DVec3| {
                let at = eye_from_ecef.transform_point3(point);
                at.z < 0.0 && at.x.abs() < -at.z * SIDE_TAN * 1.5 && at.y.abs() < -at.z * SIDE_TAN && !is_hidden(eye, point)
            };
            let samples = (0..=24).flat_map(|i| (0..=24).map(move |j| (i, j)));
            let seen = samples.filter(|(i, j)| is_seen(position(west + share(*i), south + share(*j), highest_m))).count();
            prop_assert!(!culled || seen == 0, "{seen} points are seen");
        }
    }

    /// Regression: tiles were loaded that lie partly below the frustum and partly behind the horizon, if mountains on them could
    /// be 9 km high.
    #[test]
    fn tiles_between_the_edge_of_the_image_and_the_horizon_are_culled() {
        let eye = position(8f64.to_radians(), 46f64.to_radians(), 6.0e6);
        let eye_from_ecef = DAffine3::from_mat4(look_to_mat4(eye, -eye.normalize(), DVec3::Z));
        let clip = perspective_infinite_reverse(0.628, 16.0 / 9.0, 1.0);
        let planes = EyePlanes::new(&clip, CullingMode::default()).in_frame(&eye_from_ecef, eye);
        let horizon = Horizon::new(&WGS84, &DAffine3::IDENTITY, eye).unwrap();
        let culls = |west: f64, south: f64| {
            let [west, south] = [west, south].map(f64::to_radians);
            let size = std::f64::consts::FRAC_PI_4;
            let (east, north, ellipsoid) = (west + size, south + size, WGS84);
            let region = Region { west, south, east, north, min_height_m: 0.0, max_height_m: 9000.0, ellipsoid };
            is_out_of_sight(&region, eye, (&planes, 0b1111), &horizon)
        };
        assert!(culls(-45.0, -45.0) && culls(45.0, -45.0));
        assert!(!culls(90.0, 0.0), "its corner is in the image");
    }

    /// Regression: tiles beyond the corners of a picture were loaded, since the corners of their boxes are in sight.
    #[test]
    fn tiles_are_culled_whose_boxes_alone_are_in_sight() {
        const TILES: f64 = 16.0;
        let eye = position(8f64.to_radians(), 46f64.to_radians(), 6.0e6);
        let eye_from_ecef = DAffine3::from_mat4(look_to_mat4(eye, -eye.normalize(), DVec3::Z));
        let clip = perspective_infinite_reverse(0.63, 16.0 / 9.0, 1.0);
        let planes = EyePlanes::new(&clip, CullingMode::default()).in_frame(&eye_from_ecef, eye);
        let horizon = Horizon::new(&WGS84, &DAffine3::IDENTITY, eye).unwrap();
        let size = std::f64::consts::TAU / TILES;
        let corners = (0..16).flat_map(|x| (0..8).map(move |y| (f64::from(x) * size, f64::from(y - 4) * size)));
        let (mut culled, mut kept) = (0, 0);
        for (west, south) in corners {
            let (east, north) = (west + size, south + size);
            let region = Region { west, south, east, north, min_height_m: 0.0, max_height_m: 0.0, ellipsoid: WGS84 };
            let around = region.oriented_box();
            let axes = [around.half_axes.x_axis, around.half_axes.y_axis, around.half_axes.z_axis];
            let units = axes.map(|axis| axis.normalize().as_vec3().to_array());
            let half = axes.map(|axis| axis.length() as f32);
            let crossing = planes.test_oriented((around.center - eye).as_vec3().extend(0.0), &units, half, 0b1111);
            let is_behind = horizon_point(&region).is_some_and(|at| horizon.hides_in_ecef((at - eye).as_vec3()));
            if crossing.is_some() && !is_behind {
                let is_culled = is_out_of_sight(&region, eye, (&planes, 0b1111), &horizon);
                let (longitude, latitude) = (west + 0.5 * size, south + 0.5 * size);
                let middle = eye_from_ecef.transform_point3(position(longitude, latitude, 0.0));
                let is_near = middle.truncate().length() < -0.3 * middle.z;
                assert!(!(is_culled && is_near), "{longitude} {latitude}");
                *(if is_culled { &mut culled } else { &mut kept }) += 1;
            }
        }
        assert!(culled >= 3 && kept == 23, "{culled} culled, {kept} kept");
    }
}
