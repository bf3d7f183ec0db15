//! Cascaded shadow maps of the sun: what may be set, and what cull hands to draw for them.
//!
//! A picture with shadows has up to four cascades, each a part of the depths that the eye sees. For each of them the
//! scene is culled once more: tiles, levels of detail and morphs are those of the picture's own eye, so that what
//! casts a shadow is exactly what receives it; only the frustum is another, a box along the sun's rays without an end
//! towards the sun. These culls ask for no pages and keep none.

mod fit;

use glam::{DMat3, DMat4, DVec3};

use super::RenderStage;

pub(super) use fit::Fit;

/// Most cascades of a picture.
pub const MOST_CASCADES: usize = 4;
/// Texels around each cascade's part that filters and snapping may reach into.
const MARGIN_TEXELS: f64 = 6.0;

/// Shadows of the sun. Casts: height tiles and triangles whose state writes depth and does not blend, on both sides;
/// what is masked casts its holes. Lines and points cast none. Receives: everything that the sun lights.
///
/// Pictures have them that show a camera of a view: master and slave cameras, and each eye of a stereo picture has
/// cascades of its own. Cameras inside the graph, and what is below Projection nodes and nested cameras, neither
/// receive nor cast. Cull callbacks are called for each cascade too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunShadows {
    /// Parts that the depths are split into, 1 to [`MOST_CASCADES`]; each is culled and drawn for itself.
    pub cascades: u32,
    /// Texels a side of each cascade's map, 64 to 8192; 4 bytes each.
    pub resolution_px: u32,
    /// Depth in metres up to which there are shadows; they fade out over its last tenth. Where the nearest thing is
    /// farther away than a quarter of it, as from high above, up to four times as far as that.
    pub distance_m: f64,
    /// 0 splits the depths evenly, 1 logarithmically, between them a mixture: the practical split scheme of F. Zhang
    /// et al., Parallel-Split Shadow Maps for Large-Scale Virtual Environments, 2006.
    pub split_lambda: f64,
    /// How far a point is moved along its surface's normal before it is looked up, in texels, where the sun grazes it.
    /// Less leaves stripes on lit slopes, more takes shadows off the foot of what casts them.
    pub normal_bias_texels: f32,
    /// How far a point is moved towards the sun, in texels.
    pub depth_bias_texels: f32,
    /// Nodes whose mask shares no bit with it cast no shadow.
    pub caster_mask: u32,
}

impl Default for SunShadows {
    /// Four cascades of 2048 x 2048 over 20 km.
    fn default() -> Self {
        Self {
            cascades: 4,
            resolution_px: 2048,
            distance_m: 20_000.0,
            split_lambda: 0.95,
            normal_bias_texels: 2.5,
            depth_bias_texels: 0.5,
            caster_mask: u32::MAX,
        }
    }
}

/// Why shadows cannot be as they are set; such pictures have none.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ShadowError {
    /// Not 1 to [`MOST_CASCADES`].
    #[error("sun shadows have 1 to {MOST_CASCADES} cascades, not {0}")]
    Cascades(u32),
    /// Not 64 to 8192.
    #[error("sun shadow maps have 64 to 8192 texels a side, not {0}")]
    Resolution(u32),
    /// Not above 0 and finite.
    #[error("sun shadows reach a distance above 0 and finite, not {0} m")]
    Distance(f64),
    /// Not 0 to 1.
    #[error("sun shadows are split by a lambda of 0 to 1, not {0}")]
    SplitLambda(f64),
    /// Not 0 to 64.
    #[error("biases of sun shadows are 0 to 64 texels, not {0}")]
    Bias(f32),
}

impl SunShadows {
    /// What is wrong with the settings, first things first.
    pub fn check(&self) -> Result<(), ShadowError> {
        if !(1..=MOST_CASCADES as u32).contains(&self.cascades) {
            return Err(ShadowError::Cascades(self.cascades));
        }
        if !(64..=8192).contains(&self.resolution_px) {
            return Err(ShadowError::Resolution(self.resolution_px));
        }
        if !(self.distance_m > 0.0 && self.distance_m.is_finite()) {
            return Err(ShadowError::Distance(self.distance_m));
        }
        if !(0.0..=1.0).contains(&self.split_lambda) {
            return Err(ShadowError::SplitLambda(self.split_lambda));
        }
        match [self.normal_bias_texels, self.depth_bias_texels].into_iter().find(|b| !(0.0..=64.0).contains(b)) {
            Some(bias) => Err(ShadowError::Bias(bias)),
            None => Ok(()),
        }
    }
}

/// The sun for a cull whose picture has its shadows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadowLight {
    /// Unit vector towards the sun, in the world.
    pub to_sun: DVec3,
    /// Unit vector away from the ground at the eye, in the world.
    pub up: DVec3,
    /// How.
    pub shadows: SunShadows,
}

/// A cascade: what casts shadows into a part of the depths.
#[derive(Debug, Default)]
pub struct ShadowCascade {
    /// Least and greatest depth in front of the eye that it covers, metres; it begins before the one before it ends.
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
