//! The sun as shadow maps need it.

use glam::DVec3;

use crate::scene::{Environment, SunShadows};

/// The sun and its shadow settings for one cull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::cull) struct ShadowLight {
    /// Unit vector towards the sun, in the world.
    pub to_sun: DVec3,
    /// Unit vector away from the ground at the eye, in the world.
    pub up: DVec3,
    pub shadows: SunShadows,
}

impl ShadowLight {
    /// Takes the sun of an environment.
    pub fn new(environment: &Environment, shadows: SunShadows) -> Self {
        Self { to_sun: environment.sun_direction, up: environment.up_in_world, shadows }
    }
}
