//! Settings of the sun's shadows, for views and for cameras in the graph. Plain values.

/// The maximum number of cascades of an image.
pub const MAX_CASCADES: usize = 4;

/// Shadows of the sun.
///
/// Height tiles cast shadows, and triangles whose state writes depth and does not blend, on both sides; holes of masked
/// materials let light through. Lines and points cast none. Everything that the sun lights receives shadows.
///
/// Master and slave cameras of a view have shadows, with separate cascades for each eye in stereo. Cameras in the graph have
/// them on request ([`CameraNode::shadows`](crate::scene::CameraNode::shadows)): everything below such a camera casts and
/// receives there. Geometry below other nested cameras and below Projection nodes does neither. Cull callbacks are called
/// for each cascade too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunShadows {
    /// The number of parts that the depth range is split into, 1 to [`MAX_CASCADES`]; each is culled and drawn separately.
    pub cascades: u32,
    /// The side of each cascade's map in texels, 64 to 8192; a texel has 4 bytes.
    pub resolution_px: u32,
    /// The depth in metres up to which shadows are drawn; they fade out over its last tenth. If the nearest object is farther
    /// away than a quarter of this, as from high above, shadows reach four times as far as that object.
    pub distance_m: f64,
    /// 0 splits the depths evenly, 1 logarithmically, values between mix both: the practical split scheme of F. Zhang et
    /// al., Parallel-Split Shadow Maps for Large-Scale Virtual Environments, 2006.
    pub split_lambda: f64,
    /// The offset of a point along its surface's normal before the lookup, in texels, at grazing sun. The filter reaches 3
    /// texels: less leaves stripes on lit slopes, more removes shadows of low objects.
    pub normal_bias_texels: f32,
    /// The offset of a point towards the sun before the lookup, in texels.
    pub depth_bias_texels: f32,
    /// Nodes whose mask has no bit in common cast no shadow.
    pub caster_mask: u32,
}

impl Default for SunShadows {
    /// Returns four cascades of 2048 x 2048 texels over 20 km.
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

/// Why settings of shadows are invalid; nothing with invalid settings has shadows.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ShadowError {
    /// The number of cascades is not 1 to [`MAX_CASCADES`].
    #[error("sun shadows have 1 to {MAX_CASCADES} cascades, not {0}")]
    Cascades(u32),
    /// The resolution is not 64 to 8192.
    #[error("sun shadow maps have 64 to 8192 texels a side, not {0}")]
    Resolution(u32),
    /// The distance is not positive and finite.
    #[error("sun shadows reach a distance above 0 and finite, not {0} m")]
    Distance(f64),
    /// The split lambda is not 0 to 1.
    #[error("sun shadows are split by a lambda of 0 to 1, not {0}")]
    SplitLambda(f64),
    /// A bias is not 0 to 64.
    #[error("biases of sun shadows are 0 to 64 texels, not {0}")]
    Bias(f32),
}

impl SunShadows {
    /// Returns the first error of the settings.
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
