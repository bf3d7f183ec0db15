//! Cascaded shadow maps of the sun: what cull hands to draw for them.
//!
//! A picture with shadows has up to four cascades, each a part of the depths that the eye sees. For each of them the
//! scene is culled once more: tiles, levels of detail and morphs are those of the picture's own eye, so that what
//! casts a shadow is exactly what receives it; only the frustum is another, a box along the sun's rays without an end
//! towards the sun. These culls ask for no pages and keep none.

mod casters;
mod fit;

use glam::{DMat3, DMat4, DVec3};

use super::RenderStage;
use crate::scene::Environment;

pub use crate::scene::{MAX_CASCADES, ShadowError, SunShadows};
pub(super) use fit::Fit;

/// Texels around each cascade's part that filters and snapping may reach into.
const MARGIN_TEXELS: f64 = 6.0;

/// The sun for a cull whose picture has its shadows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ShadowLight {
    /// Unit vector towards the sun, in the world.
    pub to_sun: DVec3,
    /// Unit vector away from the ground at the eye, in the world.
    pub up: DVec3,
    /// How.
    pub shadows: SunShadows,
}

impl ShadowLight {
    pub fn new(environment: &Environment, shadows: SunShadows) -> Self {
        Self { to_sun: environment.sun_direction, up: environment.up_in_world, shadows }
    }
}

/// A cascade: what casts shadows into a part of the depths.
#[derive(Debug, Default)]
pub struct ShadowCascade {
    /// Least and greatest depth in front of the eye (below 0: behind it) that it covers, metres; it begins before the
    /// one before it ends.
    pub depths_m: [f64; 2],
    /// Width of a texel, metres.
    pub texel_m: f64,
    /// Reversed-Z orthographic projection along the sun's rays, from the eye space of the picture.
    pub clip_from_eye: DMat4,
    /// Leaves in the eye space of the picture, in one bin.
    pub stage: RenderStage,
}

/// The cascades of a stage; none where it has no shadows.
#[derive(Debug, Default)]
pub struct StageShadows {
    /// As set.
    pub settings: SunShadows,
    /// Rows: two axes across the sun's rays, and the direction towards the sun; a rotation.
    pub light_from_eye: DMat3,
    /// Nearest first.
    pub cascades: Vec<ShadowCascade>,
    /// Depths between which shadows fade out, metres.
    pub fade_m: [f64; 2],
}
