//! Sun, sky and air around a scene: plain values the application sets each frame.

use glam::DVec3;

use crate::cull::{ShadowLight, SunShadows};

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
    /// What a cull must know for the shadows of its picture: for [`CullVisitor::shadow_light`].
    ///
    /// [`CullVisitor::shadow_light`]: crate::cull::CullVisitor::shadow_light
    pub fn shadow_light(&self) -> Option<ShadowLight> {
        self.shadows.map(|shadows| ShadowLight { to_sun: self.sun_direction, up: self.up_in_world, shadows })
    }
}
