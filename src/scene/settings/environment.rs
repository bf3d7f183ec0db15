//! Sun, sky and air around a scene: plain values the application sets each frame, and what cameras in the graph make of
//! them. Cull and draw read them.

use std::sync::Arc;

use glam::DVec3;

use super::sun_shadows::SunShadows;
use crate::math::WGS84;

/// Eyes closer to the world's origin are in a local frame; the earth's poles are 6,357 km from it.
const LOCAL_WORLD_RADIUS_M: f64 = 6_200_000.0;

/// What is behind everything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sky {
    /// The earth's air, from the ground to orbit: one physical model colours the sky, what is seen through it and the
    /// light of sun and sky on the ground (S. Hillaire, A Scalable and Production Ready Sky and Atmosphere Rendering
    /// Technique, 2020).
    Atmosphere,
    /// One sRGB colour, exactly: pixels without anything drawn can be counted.
    Background([u8; 3]),
}

/// Air in front of things. Under [`Sky::Atmosphere`] it is the sky's own, and the density that of aerosols, which thin out
/// to 1/e every 1.2 km. Over a background it is a haze of the horizon's colour that thins out to 1/e every 8 km.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fog {
    /// Off: everything is drawn in its own colour.
    pub enabled: bool,
    /// Share lost in a metre at height 0; 1.5e-5 leaves a third over 70 km.
    pub density_per_m: f32,
}

/// A calm sea.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Water {
    /// Height above the ellipsoid, or along `up` in a local scene, metres.
    pub height_m: f32,
    /// Linear colour where it is deep.
    pub color: [f32; 3],
}

impl Water {
    /// Water at a height.
    pub fn at(height_m: f32) -> Self {
        Self { height_m, color: [0.012, 0.05, 0.075] }
    }
}

/// Light and background of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Environment {
    /// Unit vector towards the sun, in the world.
    pub sun_direction: DVec3,
    /// Linear colour of sunlight on a surface that faces it; under an atmosphere, at height 0 with the sun overhead.
    pub sun_color: [f32; 3],
    /// Linear light from the sky, on surfaces that face up; those that face down get less, of the ground's tint. Under
    /// an atmosphere, with the sun overhead.
    pub ambient_color: [f32; 3],
    /// Haze.
    pub fog: Fog,
    /// Background.
    pub sky: Sky,
    /// A sea around the ground, drawn after what is opaque; seen from above it only.
    pub water: Option<Water>,
    /// What stands in the sun's light throws shadows; `None` costs nothing.
    pub shadows: Option<SunShadows>,
    /// Lit colours are multiplied by it and their highlights rolled off (Khronos PBR Neutral); `None` cuts them at
    /// white. What is not lit keeps its colours.
    pub exposure: Option<f32>,
    /// Unit vector away from the ground at the eye, in the world: z for a local scene, the ellipsoid's normal on
    /// a globe.
    pub up_in_world: DVec3,
}

impl Default for Environment {
    /// Morning sun from the south-east of a z-up world, thin haze, a sky.
    fn default() -> Self {
        Self {
            sun_direction: DVec3::new(0.45, -0.55, 0.7).normalize(),
            sun_color: [1.12, 1.05, 0.92],
            ambient_color: [0.18, 0.22, 0.30],
            fog: Fog { enabled: true, density_per_m: 1.2e-5 },
            sky: Sky::Atmosphere,
            water: None,
            shadows: None,
            exposure: Some(1.5),
            up_in_world: DVec3::Z,
        }
    }
}

impl Environment {
    /// As it is around another eye of the same world: over a globe, up is a matter of where one is.
    #[must_use]
    pub fn seen_from(mut self, eye_in_world: DVec3) -> Self {
        if is_over_globe(eye_in_world) {
            self.up_in_world = WGS84.up(&WGS84.geodetic(eye_in_world));
        }
        self
    }
}

/// True for eyes near a globe: of earth-centred worlds, not of local ones.
pub(crate) fn is_over_globe(eye_in_world: DVec3) -> bool {
    eye_in_world.is_finite() && eye_in_world.length() > LOCAL_WORLD_RADIUS_M
}

/// Light and air in the picture of a camera in the graph. A nested one is drawn into another picture, among its things: it
/// has neither background nor sky nor water.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum CameraEnvironment {
    /// The light of the picture that it hangs in, the air as that picture's eye has it, no sky and no water: models,
    /// overlays, parts of the picture.
    #[default]
    Light,
    /// All of the environment of the picture that it hangs in, as the camera's own eye sees it: mirrors, maps, other
    /// views of the same world. Background, sky and water are drawn where the camera clears its colour.
    Inherited,
    /// The same, of an environment of its own.
    Own(Arc<Environment>),
}

impl CameraEnvironment {
    /// What a camera has; `above` is what the picture has that it hangs in, where that is known.
    pub(crate) fn of_camera(&self, above: Option<&Environment>, eye_in_world: DVec3) -> Option<Environment> {
        match self {
            Self::Light => above.copied(),
            Self::Inherited => above.map(|e| e.seen_from(eye_in_world)),
            Self::Own(own) => Some(own.seen_from(eye_in_world)),
        }
    }

    /// True where the camera has sky and air by its own eye.
    pub(crate) fn is_whole(&self) -> bool {
        *self != Self::Light
    }
}

/// Shadows of the sun in the picture of a camera in the graph: cascades of its own, cast by what is below it. Each is
/// culled and drawn for itself; see [`CullSettings::shadowed_cameras`]. The maps are shared, one camera's after the
/// other's; those of nested cameras lie beside those of the picture that they are drawn in.
///
/// [`CullSettings::shadowed_cameras`]: super::CullSettings::shadowed_cameras
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CameraShadows {
    /// None.
    #[default]
    None,
    /// As the camera's environment says: that of the picture it hangs in, or its own.
    Environment,
    /// Others.
    Own(SunShadows),
}

impl CameraShadows {
    /// What a camera has under its environment.
    pub(crate) fn under(&self, environment: &Environment) -> Option<SunShadows> {
        match self {
            Self::None => None,
            Self::Environment => environment.shadows,
            Self::Own(shadows) => Some(*shadows),
        }
    }
}
