//! How shadows of the sun are made: plain values, for pictures and for cameras in the graph.

/// Most cascades of a picture.
pub const MAX_CASCADES: usize = 4;

/// Shadows of the sun. Casts: height tiles and triangles whose state writes depth and does not blend, on both sides;
/// what is masked casts its holes. Lines and points cast none. Receives: everything that the sun lights.
///
/// Pictures have them that show a camera of a view: master and slave cameras, and each eye of a stereo picture has
/// cascades of its own. Cameras in the graph have them where they ask
/// ([`CameraNode::shadows`](crate::scene::CameraNode::shadows)): what is below them casts and receives there. What is below
/// other nested cameras and below Projection nodes does neither. Cull callbacks are called for each cascade too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunShadows {
    /// Parts that the depths are split into, 1 to [`MAX_CASCADES`]; each is culled and drawn for itself.
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
    /// Less than the 3 that the filter reaches leaves stripes on lit slopes, more takes shadows off what is low.
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
            normal_bias_texels: 3.0,
            depth_bias_texels: 0.5,
            caster_mask: u32::MAX,
        }
    }
}

/// Why shadows cannot be as they are set; such pictures have none.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ShadowError {
    /// Not 1 to [`MAX_CASCADES`].
    #[error("sun shadows have 1 to {MAX_CASCADES} cascades, not {0}")]
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
        if !(1..=MAX_CASCADES as u32).contains(&self.cascades) {
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
