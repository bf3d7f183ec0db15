//! Horizon culling: tiles behind the body of the earth are culled.
//!
//! Seen from outside, an ellipsoid hides a cone with the eye as apex, cut off at the plane of the horizon. In space scaled
//! by the radii the ellipsoid is the unit sphere. A sphere around a tile is hidden if its centre lies in that cone by at
//! least the radius (for points: K. Ring and P. Cozzi, "Horizon Culling", cesium.com/blog, 2013).

use glam::{DAffine3, DMat3, DVec3, Mat3, Vec3};

use crate::math::Ellipsoid;

/// The hidden cone in one frame of tiles.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct Horizon {
    /// Linear map from the frame to scaled space.
    scaled_from_frame: Mat3,
    /// Unit direction from the eye to the body's centre, in scaled space.
    axis: Vec3,
    /// Distance of the horizon's plane from the eye along the axis.
    plane: f32,
    /// Sine of the half angle of the cone.
    sin: f32,
    /// Cosine of the half angle of the cone.
    cos: f32,
    /// Upper limit of the scaled length of one metre of the frame.
    scale: f32,
    /// The frame is the body's own, with the body in its middle.
    is_ecef: bool,
}

/// The distances from the identity up to which a frame is the body's own: of the matrix, and of the origin in metres.
const IDENTITY: [f64; 2] = [1e-9, 0.1];

/// Upper limit of the rounding error of f32, as a share of the distance.
const ROUNDING: f32 = 5e-7;

impl Horizon {
    /// Computes the cone. Returns `None` if the eye is not above the body, or if a matrix is degenerate.
    pub fn new(body: &Ellipsoid, world_from_frame: &DAffine3, eye_in_world: DVec3) -> Option<Self> {
        let shrink = body.radii_m().recip();
        let eye = eye_in_world * shrink;
        let distance2 = eye.length_squared();
        // Closer to the body the cone is nearly a half space, and rounding would decide.
        if !(distance2 > 1.0 + 1e-9 && distance2 < 1e12) {
            return None;
        }
        let distance = distance2.sqrt();
        let linear = DMat3::from_diagonal(shrink) * world_from_frame.matrix3;
        let scale = crate::math::max_scale(&world_from_frame.matrix3) * shrink.max_element();
        if !linear.is_finite() || !scale.is_finite() {
            return None;
        }
        Some(Self {
            scaled_from_frame: linear.as_mat3(),
            axis: (-eye / distance).as_vec3(),
            plane: ((distance2 - 1.0) / distance) as f32,
            sin: (1.0 / distance) as f32,
            cos: ((distance2 - 1.0).sqrt() / distance) as f32,
            scale: (scale * (1.0 + 1e-6)) as f32,
            is_ecef: world_from_frame.matrix3.abs_diff_eq(DMat3::IDENTITY, IDENTITY[0])
                && world_from_frame.translation.abs_diff_eq(DVec3::ZERO, IDENTITY[1]),
        })
    }

    /// Returns true if the frame is the body's own.
    pub fn is_in_ecef(&self) -> bool {
        self.is_ecef
    }

    /// Returns true if a point that stands for a part of the body is behind the horizon. `offset` is its offset from the eye
    /// in ECEF metres; nothing is hidden in another frame.
    #[inline]
    pub fn hides_in_ecef(&self, offset: Vec3) -> bool {
        self.is_ecef && self.hides(offset.to_array(), 0.0)
    }

    /// Returns true if a sphere lies wholly behind the horizon. `offset` is its centre relative to the eye, in the frame.
    #[inline(always)]
    pub fn hides(&self, offset: [f32; 3], radius_m: f32) -> bool {
        let v = self.scaled_from_frame * Vec3::from_array(offset);
        let along = v.dot(self.axis);
        if along <= self.plane {
            return false;
        }
        let radius = radius_m * self.scale + ROUNDING * v.length();
        let across = (v - self.axis * along).length();
        along - self.plane >= radius && along * self.sin - across * self.cos >= radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Region, WGS84, horizon_point};
    use glam::{DQuat, EulerRot};
    use proptest::prelude::*;

    /// Returns true if the straight line from the eye to the point hits the ellipsoid before the point.
    fn hidden(eye: DVec3, point: DVec3) -> bool {
        let shrink = DVec3::new(1.0 / WGS84.semi_major_m, 1.0 / WGS84.semi_major_m, 1.0 / WGS84.semi_minor_m);
        let (a, d) = (eye * shrink, (point - eye) * shrink);
        let (qa, qb, qc) = (d.length_squared(), a.dot(d), a.length_squared() - 1.0);
        let root = qb * qb - qa * qc;
        root >= 0.0 && {
            let t = (-qb - root.sqrt()) / qa;
            (0.0..=1.0 + 1e-9).contains(&t)
        }
    }

    fn position(longitude: f64, latitude: f64, height_m: f64) -> DVec3 {
        WGS84.ecef(&crate::math::Geodetic { longitude, latitude, height_m })
    }

    proptest! {
        /// No point of a culled sphere is visible, and a sphere far behind the horizon is culled.
        #[test]
        fn hides_exactly_the_invisible_spheres(
            (lon, lat) in (-3.1..3.1f64, -1.5..1.5f64),
            height in 0.3..8.0f64,
            (away, turn) in (0.0..1.0f64, 0.0..std::f64::consts::TAU),
            (target_height, radius) in (-3.0..4.0f64, 0.0..5.5f64),
            points in prop::collection::vec((0.0..std::f64::consts::TAU, -1.0..1.0f64), 40),
            turns in prop::array::uniform3(-3.1..3.1f64),
        ) {
            let eye = position(lon, lat, 10f64.powf(height));
            // A target between the eye and its antipode, more often close to the eye.
            let angle = 3.0 * away * away;
            let up = eye.normalize();
            let side = up.any_orthonormal_vector();
            let side = side * turn.cos() + up.cross(side) * turn.sin();
            let direction = up * angle.cos() + side * angle.sin();
            let ground = WGS84.geodetic(direction * 6.37e6);
            let center = position(ground.longitude, ground.latitude, target_height.signum() * 10f64.powf(target_height.abs()));
            let radius = 10f64.powf(radius);
            let frame = DAffine3::from_quat(DQuat::from_euler(EulerRot::XYZ, turns[0], turns[1], turns[2]));
            let offset = frame.inverse().transform_vector3(center - eye).as_vec3().to_array();
            let Some(horizon) = Horizon::new(&WGS84, &frame, eye) else { panic!("{eye}") };
            prop_assert!(f64::from(horizon.scale) >= 1.0 / WGS84.semi_minor_m, "no scaled radius is too small");
            let hides = horizon.hides(offset, radius as f32);
            let on_sphere = |(a, z): &(f64, f64)| {
                let r = (1.0 - z * z).sqrt();
                center + radius * DVec3::new(r * a.cos(), r * a.sin(), *z)
            };
            if hides {
                prop_assert!(hidden(eye, center));
                for point in points.iter().map(on_sphere) {
                    prop_assert!(hidden(eye, point), "culled, and {point} is seen from {eye}");
                }
            } else if radius > 100.0 && target_height > 0.0 {
                // Some point of a slightly larger sphere is visible: on its surface, at its top, or at its rim.
                let zenith = center.normalize();
                let around = points.iter().map(on_sphere).chain([center + radius * zenith]);
                let grown = around.map(|p| center + (p - center) * 1.05 + zenith * 30.0);
                let toward = (eye - center).normalize();
                let rim = (zenith - toward * zenith.dot(toward)).normalize_or_zero();
                let highest = center + (radius * 1.05 + 30.0) * rim;
                prop_assert!(grown.chain([highest]).any(|p| !hidden(eye, p)), "kept, and nothing of it is seen");
            }
        }
    }

    proptest! {
        /// A part of the earth is culled by its point only if nothing of it is seen, and is culled far behind the horizon.
        #[test]
        fn horizon_points_hide_exactly_what_is_not_seen(
            (lon, lat) in (-3.1..3.1f64, -1.5..1.5f64),
            height in 1.0..7.5f64,
            (west, south) in (-3.1..3.1f64, -1.5..1.5f64),
            (width, tall) in (0.001..0.8f64, 0.001..0.8f64),
            highest in -50.0..9000.0f64,
        ) {
            let north = (south + tall).min(std::f64::consts::FRAC_PI_2);
            let region = Region { west, south, east: west + width, north, min_height_m: -100.0, max_height_m: highest, ellipsoid: WGS84 };
            let eye = position(lon, lat, 10f64.powf(height));
            let Some(horizon) = Horizon::new(&WGS84, &DAffine3::IDENTITY, eye) else { panic!("{eye}") };
            let hides = horizon_point(&region).is_some_and(|point| horizon.hides_in_ecef((point - eye).as_vec3()));
            let share = |i: u32| f64::from(i) / 12.0;
            let samples = (0..=12).flat_map(|i| (0..=12).map(move |j| (i, j)));
            let mut points = samples.map(|(i, j)| position(west + width * share(i), south + (north - south) * share(j), highest));
            if hides {
                prop_assert!(points.all(|point| hidden(eye, point)), "culled, and a part is seen from {eye}");
            } else {
                // From the horizon of the eye to that of the highest point, with the extent of the region and of the lowest body.
                let reach = (WGS84.semi_major_m / eye.length()).min(1.0).acos() + 1.7 * (width + tall) + 0.3;
                let seen = points.any(|point| eye.angle_between(point) < reach);
                prop_assert!(seen, "kept, far behind the horizon");
            }
        }
    }

    #[test]
    fn points_hide_nothing_in_another_frame() {
        let turned = DAffine3::from_rotation_z(0.1);
        for (frame, hides) in [(DAffine3::IDENTITY, true), (turned, false)] {
            let horizon = Horizon::new(&WGS84, &frame, position(0.0, 0.0, 1000.0)).unwrap();
            assert_eq!(horizon.hides_in_ecef(Vec3::new(-1.3e7, 0.0, 0.0)), hides);
        }
    }

    #[test]
    fn nothing_is_hidden_from_below_the_ground() {
        assert!(Horizon::new(&WGS84, &DAffine3::IDENTITY, position(0.2, 0.3, -10.0)).is_none());
        assert!(Horizon::new(&WGS84, &DAffine3::IDENTITY, DVec3::NAN).is_none());
        let horizon = Horizon::new(&WGS84, &DAffine3::IDENTITY, position(0.0, 0.0, 1000.0)).unwrap();
        assert!(!horizon.hides([f32::NAN; 3], 1.0) && !horizon.hides([-1e9, 0.0, 0.0], f32::INFINITY));
        assert!(horizon.hides([-1.2e7, 0.0, 0.0], 1000.0), "the other side of the earth");
    }
}
