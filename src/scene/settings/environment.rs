//! Sun, sky and air around a scene: plain values that the application sets each frame, and how cameras in the graph derive
//! theirs. Culls and draws read them.

use std::sync::Arc;

use glam::DVec3;

use super::sun_shadows::SunShadows;
use super::tone_mapping::ToneMapping;
use crate::math::{Ellipsoid, WGS84};

/// Eyes closer to the world's origin than this share of the body's shortest radius are in a local frame, not over a globe.
const LOCAL_WORLD_SHARE: f64 = 0.9753;

/// The background behind everything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sky {
    /// The earth's air, from the ground to orbit: one physical model colours the sky, objects seen through the air, and the
    /// light of sun and sky on the ground (S. Hillaire, A Scalable and Production Ready Sky and Atmosphere Rendering
    /// Technique, 2020).
    Atmosphere,
    /// One exact sRGB colour, so that tests can count pixels on which nothing was drawn.
    Background([u8; 3]),
}

/// Haze in front of objects. Under [`Sky::Atmosphere`] the density is that of aerosols, which decreases by 1/e every 1.2 km
/// of height. Over a background the haze has the horizon's colour and decreases by 1/e every 8 km.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistanceFog {
    /// If false, everything is drawn in its own colour.
    pub enabled: bool,
    /// The fraction of light lost per metre at height 0; 1.5e-5 leaves a third over 70 km. Under an atmosphere the air itself
    /// adds [`Self::AIR_PER_M`], so that the meteorological range is 3.912 / (density + 1.36e-5) metres.
    pub density_per_m: f32,
}

impl DistanceFog {
    /// The fraction of green light (550 nm) that air without aerosols scatters per metre at height 0 (E. Bruneton and
    /// F. Neyret, Precomputed Atmospheric Scattering, 2008). Its meteorological range is 288 km.
    pub const AIR_PER_M: f64 = 13.558e-6;

    /// The density of aerosols of clear air under an atmosphere, whose meteorological range near the ground is 100 km.
    ///
    /// Koschmieder's law (1924) says that the contrast of a far object falls by exp(-extinction x distance). The
    /// meteorological range is the distance at which 2 % are left: -ln 0.02 = 3.912, divided by the extinction.
    pub const CLEAR_AIR_PER_M: f32 = (3.912 / 100_000.0 - Self::AIR_PER_M) as f32;
}

/// A calm sea.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Water {
    /// The height above the ellipsoid, or along `up_in_world` in a local scene, metres.
    pub height_m: f32,
    /// The linear colour of deep water.
    pub color: [f32; 3],
}

impl Water {
    /// Returns water at a height in metres.
    pub fn at(height_m: f32) -> Self {
        Self { height_m, color: [0.012, 0.05, 0.075] }
    }
}

/// Light and background of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Environment {
    /// The unit vector towards the sun, in the world.
    pub sun_direction: DVec3,
    /// The linear colour of sunlight on a surface that faces the sun; under an atmosphere, at height 0 with the sun overhead.
    pub sun_color: [f32; 3],
    /// The linear light of the sky on surfaces that face up; surfaces that face down get less, tinted by the ground. Under an
    /// atmosphere, with the sun overhead.
    pub ambient_color: [f32; 3],
    /// The share of `ambient_color` that remains where the sun does not shine: on the night side of a globe, and everywhere after
    /// sunset; 0 to 1. The default, [`Self::NIGHT_LIGHT`], is a dark night. Without an atmosphere 0.15 remain at least.
    pub night_light: f32,
    /// Haze.
    pub fog: DistanceFog,
    /// Background.
    pub sky: Sky,
    /// A sea around the ground, drawn after opaque geometry; visible only from above.
    pub water: Option<Water>,
    /// Shadows of the sun; `None` costs nothing.
    pub shadows: Option<SunShadows>,
    /// A factor on lit colours, whose highlights are then compressed (Khronos PBR Neutral); `None` clamps them at white. Unlit
    /// colours are not changed. The default is [`Self::EXPOSURE`].
    pub exposure: Option<f32>,
    /// The pass that applies exposure and compression.
    pub tone_mapping: ToneMapping,
    /// The unit vector away from the ground at the eye, in the world: z for a local scene, the ellipsoid's normal on a globe.
    pub up_in_world: DVec3,
    /// The ellipsoid of the body that the world is: heights of eyes, air and water are above it.
    pub ellipsoid: Ellipsoid,
}

impl Default for Environment {
    /// Returns morning sun from the south-east of a z-up world, clear air and an atmosphere.
    fn default() -> Self {
        Self {
            sun_direction: DVec3::new(0.45, -0.55, 0.7).normalize(),
            sun_color: [1.12, 1.05, 0.92],
            ambient_color: [0.18, 0.22, 0.30],
            night_light: Self::NIGHT_LIGHT,
            fog: DistanceFog { enabled: true, density_per_m: DistanceFog::CLEAR_AIR_PER_M },
            sky: Sky::Atmosphere,
            water: None,
            shadows: None,
            exposure: Some(Self::EXPOSURE),
            tone_mapping: ToneMapping::default(),
            up_in_world: DVec3::Z,
            ellipsoid: WGS84,
        }
    }
}

impl Environment {
    /// The exposure with which level ground under the default sun and sky is displayed in the colour of its image.
    ///
    /// It is the albedo over the light that the ground reflects: the default sun, 44 degrees high, and the sky give level
    /// ground 0.88 of the light of `sun_color` 1. A mid-grey surface (0.18) that faces the sun is displayed as sRGB 134.
    pub const EXPOSURE: f32 = 1.15;

    /// The default of [`Self::night_light`].
    pub const NIGHT_LIGHT: f32 = 0.03;

    /// The illuminance in lux of sunlight whose `sun_color` is 1, on a surface that faces the sun: 100,000. The default
    /// sun has 105,000 lux, as the real one overhead.
    ///
    /// It relates photometric units to linear colours: a light of `E` lux has the colour `E / 100,000`. With the exposure of
    /// a day, lamps are as weak as they are beside the sun. Where lamps of `E` lux are the only light, a `sun_color` of 0 and
    /// an exposure of `100,000 / E` show white surfaces white. That is 1,000 for a room of 100 lux.
    pub const SUN_LUX: f32 = 100_000.0;

    /// The light of the ground around on surfaces in shadow, where there is no air.
    const AIRLESS_AMBIENT: [f32; 3] = [0.03; 3];

    /// Returns the usual environment of a body. The earth has its air; another body has a black sky, no haze, a white sun and
    /// dark shadows.
    pub fn on(ellipsoid: Ellipsoid) -> Self {
        let earth = Self { ellipsoid, ..Self::default() };
        if ellipsoid.is_earth() {
            return earth;
        }
        Self {
            sky: Sky::Background([0; 3]),
            fog: DistanceFog { enabled: false, ..earth.fog },
            sun_color: [1.1; 3],
            ambient_color: Self::AIRLESS_AMBIENT,
            ..earth
        }
    }

    /// Changes to the usual sky, haze and light of another body, as far as those of the present one were not replaced.
    pub(crate) fn move_to(&mut self, ellipsoid: Ellipsoid) {
        let (here, there) = (Self::on(self.ellipsoid), Self::on(ellipsoid));
        let is_usual = |own: &Self| {
            let look = |of: &Self| (of.sky, of.fog.enabled, of.sun_color, of.ambient_color);
            look(own) == look(&here)
        };
        if is_usual(self) {
            (self.sky, self.fog.enabled) = (there.sky, there.fog.enabled);
            (self.sun_color, self.ambient_color) = (there.sun_color, there.ambient_color);
        }
        self.ellipsoid = ellipsoid;
    }

    /// Returns the environment around another eye of the same world: over a globe, `up_in_world` depends on the position.
    #[must_use]
    pub fn seen_from(mut self, eye_in_world: DVec3) -> Self {
        if self.is_over_globe(eye_in_world) {
            self.up_in_world = self.ellipsoid.up(&self.ellipsoid.geodetic(eye_in_world));
        }
        self
    }

    /// Returns true if an eye is near or above a globe in a body-centred world, not in a local one.
    pub(crate) fn is_over_globe(&self, eye_in_world: DVec3) -> bool {
        let Ellipsoid { semi_major_m, semi_minor_m } = self.ellipsoid;
        eye_in_world.is_finite() && eye_in_world.length() > LOCAL_WORLD_SHARE * semi_major_m.min(semi_minor_m)
    }
}

/// Light and air in the image of a camera in the graph. A nested camera draws into the image of another camera and has no
/// background, sky or water.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum CameraEnvironment {
    /// Light and air of the surrounding image, as its eye has them; no sky and no water. For models, overlays and parts of the
    /// image.
    #[default]
    Light,
    /// The whole environment of the surrounding image, as the camera's own eye sees it. For mirrors, maps and other views of
    /// the same world. Background, sky and water are drawn if the camera clears its colour.
    Inherited,
    /// A separate environment, as the camera's own eye sees it.
    Own(Arc<Environment>),
}

impl CameraEnvironment {
    /// Returns the environment of a camera. `above` is that of the surrounding image, if known.
    pub(crate) fn of_camera(&self, above: Option<&Environment>, eye_in_world: DVec3) -> Option<Environment> {
        match self {
            Self::Light => above.copied(),
            Self::Inherited => above.map(|e| e.seen_from(eye_in_world)),
            Self::Own(own) => Some(own.seen_from(eye_in_world)),
        }
    }

    /// Returns true if the camera has sky and air as its own eye sees them.
    pub(crate) fn is_whole(&self) -> bool {
        *self != Self::Light
    }
}

/// Shadows of the sun in the image of a camera in the graph: separate cascades, cast by everything below it. Each cascade is
/// culled and drawn; see [`CullSettings::shadowed_cameras`]. Cameras use the same maps one after the other; the maps of a
/// nested camera lie beside those of the surrounding image.
///
/// [`CullSettings::shadowed_cameras`]: crate::scene::CullSettings::shadowed_cameras
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CameraShadows {
    /// No shadows.
    #[default]
    None,
    /// The shadows of the camera's environment: that of the surrounding image, or its own.
    Environment,
    /// Separate settings.
    Own(SunShadows),
}

impl CameraShadows {
    /// Returns the shadows of a camera that has an environment.
    pub(crate) fn under(&self, environment: &Environment) -> Option<SunShadows> {
        match self {
            Self::None => None,
            Self::Environment => environment.shadows,
            Self::Own(shadows) => Some(*shadows),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::MOON;

    #[test]
    fn usual_sky_follows_the_body_and_a_chosen_one_stays() {
        let mut environment = Environment::default();
        environment.move_to(MOON);
        assert_eq!(environment, Environment::on(MOON));
        assert!(environment.sky == Sky::Background([0; 3]) && !environment.fog.enabled);
        environment.move_to(WGS84);
        assert_eq!(environment, Environment::default());
        let chosen = Environment { sky: Sky::Background([1, 2, 3]), ..Environment::default() };
        environment = chosen;
        environment.move_to(MOON);
        assert_eq!(environment, Environment { ellipsoid: MOON, ..chosen });
    }

    /// An eye is over a globe from its surface on, on bodies of any size.
    #[test]
    fn up_is_the_normal_of_the_body() {
        let eye = DVec3::new(0.0, 0.0, 1_738_000.0);
        assert!(Environment::on(MOON).seen_from(eye).up_in_world.distance(DVec3::Z) < 1e-12);
        let aside = DVec3::X * 1_738_000.0;
        assert!(Environment::on(MOON).seen_from(aside).up_in_world.distance(DVec3::X) < 1e-12);
        assert_eq!(Environment::default().seen_from(aside).up_in_world, DVec3::Z, "a local scene of the earth");
    }
}
