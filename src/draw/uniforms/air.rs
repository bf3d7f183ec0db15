//! The parameters of the air that an eye looks through: they decide which tables the shaders read
//! ([`AirPass`](crate::draw::passes::air::AirPass)). Plain values.
//!
//! Coefficients are those of E. Bruneton, Precomputed Atmospheric Scattering.

use std::f64::consts::PI;

use glam::DVec3;

use crate::cull::CullCamera;
use crate::scene::Environment;

/// Radii in kilometres, as in air.wgsl: the ground at height 0, the top of the air, the lowest ground.
const EARTH_KM: f64 = 6371.0;
const AIR_KM: f64 = 6471.0;
const LOWEST_KM: f64 = 6368.0;
/// Scattering of air and absorption of ozone per kilometre at their greatest density: red, green and blue.
const RAYLEIGH_PER_KM: [f64; 3] = [5.802e-3, 13.558e-3, 33.1e-3];
const OZONE_PER_KM: [f64; 3] = [0.650e-3, 1.881e-3, 0.085e-3];
/// The vertical columns of air, aerosols and ozone as kilometres of their greatest density.
const RAYLEIGH_COLUMN_KM: f64 = 8.0;
const MIE_COLUMN_KM: f64 = 1.2;
const OZONE_COLUMN_KM: f64 = 15.0;
/// Greatest extinction of aerosols per kilometre: the visual range is 40 m.
const MAX_AEROSOL_PER_KM: f64 = 100.0;

/// The parameters of a set of air tables.
///
/// They are rounded, so that the tables depend on the current frame alone and not on the frame that computed them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::draw) struct AirParameters {
    /// Distance of the eye from the earth's centre in kilometres.
    pub(in crate::draw) eye_km: f32,
    /// Cosine of the angle from the zenith to the horizon of the lowest ground.
    pub(in crate::draw) horizon_cosine: f32,
    /// Cosine of the angle from the zenith to the limb of the air; 1 inside the air.
    pub(in crate::draw) limb_cosine: f32,
    /// Cosine of the angle from the zenith to the sun.
    pub(in crate::draw) sun_cosine: f32,
    /// Extinction of aerosols at height 0, per kilometre.
    pub(in crate::draw) aerosol_per_km: f32,
}

/// Keeps the ten highest bits of a number's significand.
fn rounded(x: f64) -> f64 {
    f64::from(f32::from_bits((x as f32).to_bits() & 0xffff_e000))
}

impl AirParameters {
    /// Returns the parameters for the eye of a camera.
    pub(in crate::draw) fn of(camera: &CullCamera, environment: &Environment) -> Self {
        let (height_m, _) = eye_height_m(camera, environment);
        let density = f64::from(environment.fog.density_per_m) * 1e3;
        let aerosol = if density.is_finite() { density.clamp(0.0, MAX_AEROSOL_PER_KM) } else { 0.0 };
        Self::at(rounded(height_m * 1e-3), sun_height(camera, environment), aerosol)
    }

    pub(in crate::draw) fn at(height_km: f64, sun_cosine: f64, aerosol_per_km: f64) -> Self {
        // Shaders have the radius as f32, in steps of half a metre.
        let eye_km = (EARTH_KM + height_km) as f32;
        let r = f64::from(eye_km);
        let limb = |radius: f64| -(((r - radius) * (r + radius)).max(0.0)).sqrt() / r;
        Self {
            eye_km,
            horizon_cosine: limb(LOWEST_KM) as f32,
            limb_cosine: if r > AIR_KM { limb(AIR_KM) as f32 } else { 1.0 },
            sun_cosine: ((sun_cosine * 8192.0).round() / 8192.0).clamp(-1.0, 1.0) as f32,
            aerosol_per_km: rounded(aerosol_per_km) as f32,
        }
    }

    /// Returns the irradiance of the sun outside the air that gives a colour (irradiance over pi) to the ground under a
    /// sun in the zenith.
    pub(in crate::draw) fn sun_irradiance(&self, color_on_ground: [f32; 3]) -> [f32; 3] {
        let left = self.sunlight_from_zenith();
        [0, 1, 2].map(|i| (f64::from(color_on_ground[i]) * PI / left[i]) as f32)
    }

    /// Returns the share of sunlight from the zenith that reaches height 0: at least 0.05, since thick haze would
    /// otherwise need an endlessly bright sun.
    fn sunlight_from_zenith(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| {
            let depth = RAYLEIGH_PER_KM[i] * RAYLEIGH_COLUMN_KM
                + f64::from(self.aerosol_per_km) * MIE_COLUMN_KM
                + OZONE_PER_KM[i] * OZONE_COLUMN_KM;
            (-depth).exp().max(0.05)
        })
    }
}

/// Returns the eye-space direction of a direction in the world.
pub(in crate::draw) fn direction_in_eye(camera: &CullCamera, world: DVec3) -> [f64; 3] {
    camera.eye_from_world.matrix3.mul_vec3(world).normalize_or(DVec3::Z).to_array()
}

/// Returns the height of a camera's eye in metres, and whether it is near a globe. Only air and water depend on it; a
/// local frame counts as flat with its ground at 0.
pub(in crate::draw) fn eye_height_m(camera: &CullCamera, environment: &Environment) -> (f64, bool) {
    let eye = camera.eye_from_world.inverse().translation;
    let is_globe = environment.is_over_globe(eye);
    let height_m =
        if is_globe { environment.ellipsoid.geodetic(eye).height_m } else { eye.dot(environment.up_in_world) };
    (if height_m.is_finite() { height_m.max(0.0) } else { 0.0 }, is_globe)
}

/// Returns the sine of the sun's elevation at the eye.
pub(in crate::draw) fn sun_height(camera: &CullCamera, environment: &Environment) -> f64 {
    let sun = DVec3::from(direction_in_eye(camera, environment.sun_direction));
    sun.dot(direction_in_eye(camera, environment.up_in_world).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::DistanceFog;

    #[test]
    fn clear_air_leaves_two_percent_of_contrast_over_100_km() {
        let air = AirParameters::of(&CullCamera::default(), &Environment::default());
        // Green light near the ground, where there is no ozone.
        let extinction_per_km = RAYLEIGH_PER_KM[1] + f64::from(air.aerosol_per_km);
        let contrast = |distance_km: f64| (-extinction_per_km * distance_km).exp();
        assert!((99.5..100.5).contains(&(3.912 / extinction_per_km)), "{extinction_per_km}");
        assert!((0.0195..0.0205).contains(&contrast(100.0)), "{}", contrast(100.0));
        assert!(contrast(10.0) > 0.65, "{}", contrast(10.0));
        assert!((DistanceFog::AIR_PER_M * 1e3 - RAYLEIGH_PER_KM[1]).abs() < 1e-12);
    }
}
