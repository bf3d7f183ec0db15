//! Attributes of the fixed stages of the pipeline: blending, depth, faces, stencil and the area that is drawn to.

/// A factor of [`BlendFunc`].
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum BlendFactor {
    Zero,
    #[default]
    One,
    SrcColor,
    OneMinusSrcColor,
    SrcAlpha,
    OneMinusSrcAlpha,
    DstColor,
    OneMinusDstColor,
    DstAlpha,
    OneMinusDstAlpha,
    SrcAlphaSaturate,
    /// The [`Attribute::BlendColor`](super::Attribute::BlendColor).
    ConstantColor,
    OneMinusConstantColor,
    /// The alpha of the [`Attribute::BlendColor`](super::Attribute::BlendColor). wgpu has one constant: in a state that also
    /// weights colours with `ConstantColor` it is that colour, which the renderer reports once.
    ConstantAlpha,
    OneMinusConstantAlpha,
}

impl BlendFactor {
    pub(crate) fn is_constant_color(self) -> bool {
        matches!(self, Self::ConstantColor | Self::OneMinusConstantColor)
    }

    pub(crate) fn is_constant_alpha(self) -> bool {
        matches!(self, Self::ConstantAlpha | Self::OneMinusConstantAlpha)
    }
}

/// The factors of source and destination in blending: of colour, and of alpha where the target has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlendFunc {
    /// Factor of the colour that is drawn.
    pub source: BlendFactor,
    /// Factor of the colour in the target.
    pub destination: BlendFactor,
    /// Factor of the alpha that is drawn.
    pub source_alpha: BlendFactor,
    /// Factor of the alpha in the target.
    pub destination_alpha: BlendFactor,
}

impl BlendFunc {
    /// `SRC_ALPHA, ONE_MINUS_SRC_ALPHA`: the default.
    pub const ALPHA: Self = Self::new(BlendFactor::SrcAlpha, BlendFactor::OneMinusSrcAlpha);
    /// `ONE, ONE`: adds light.
    pub const ADD: Self = Self::new(BlendFactor::One, BlendFactor::One);

    /// Uses the same factors for colour and alpha.
    pub const fn new(source: BlendFactor, destination: BlendFactor) -> Self {
        Self { source, destination, source_alpha: source, destination_alpha: destination }
    }

    /// Keeps the factors of colour and sets those of alpha.
    pub const fn with_alpha(self, source_alpha: BlendFactor, destination_alpha: BlendFactor) -> Self {
        Self { source_alpha, destination_alpha, ..self }
    }

    /// Returns true if one of the factors is the [`Attribute::BlendColor`](super::Attribute::BlendColor) or its alpha.
    pub(crate) fn has_constant(&self) -> bool {
        let factors = [self.source, self.destination, self.source_alpha, self.destination_alpha];
        factors.iter().any(|factor| factor.is_constant_color() || factor.is_constant_alpha())
    }

    /// Returns true if one of the factors of colours is of a kind.
    pub(crate) fn weights(&self, is_kind: fn(BlendFactor) -> bool) -> bool {
        is_kind(self.source) || is_kind(self.destination)
    }
}

/// The operation that combines the weighted source and destination.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum BlendEquation {
    #[default]
    Add,
    Subtract,
    ReverseSubtract,
    Min,
    Max,
}

/// A comparison.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CompareFunction {
    Never,
    Less,
    Equal,
    LessOrEqual,
    Greater,
    NotEqual,
    GreaterOrEqual,
    Always,
}

/// Depth test and depth writes. `Less` passes what is nearer to the eye, as in OpenGL, although depths are stored
/// reversed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Depth {
    /// Compares the depth that is drawn with the depth in the target.
    pub function: CompareFunction,
    /// Depths that pass are written.
    pub write: bool,
    /// Depths of the near plane and of infinity, 0 to 1. A drawable with `[0, 0.1]` lies before all with `[0.1, 1]`.
    pub range: [f32; 2],
}

impl Default for Depth {
    fn default() -> Self {
        Self { function: CompareFunction::Less, write: true, range: [0.0, 1.0] }
    }
}

/// The faces that are not drawn where [`Mode::CullFace`](super::Mode::CullFace) is on.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CullFace {
    Front,
    #[default]
    Back,
    FrontAndBack,
}

/// The winding order of front faces.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum FrontFace {
    #[default]
    CounterClockwise,
    Clockwise,
}

/// The rasterisation of triangles. Lines and points need support by the adapter; without it triangles are filled.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum PolygonMode {
    #[default]
    Fill,
    Line,
    Point,
}

/// Moves the depth of triangles by `factor * slope + units * smallest step`; positive is away from the eye, as in
/// OpenGL.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PolygonOffset {
    /// Factor of the slope.
    pub factor: f32,
    /// Offset in the smallest steps of the depth buffer.
    pub units: f32,
}

/// The components that are written: red, green, blue, alpha. Windows stay opaque: alpha is written to textures alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ColorMask(pub [bool; 4]);

impl ColorMask {
    /// Returns the written components, red in bit 0 to alpha in bit 3.
    pub(crate) fn bits(self) -> u8 {
        (0..).zip(self.0).map(|(bit, is_written)| u8::from(is_written) << bit).sum()
    }

    /// Returns true if all components are written.
    pub(crate) fn is_whole(self) -> bool {
        self == Self::default()
    }
}

impl Default for ColorMask {
    fn default() -> Self {
        Self([true; 4])
    }
}

/// The samples of a pixel that are drawn where [`Mode::SampleMask`](super::Mode::SampleMask) is on; without effect on targets
/// of one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SampleMask {
    /// The bits of the samples; OSG's `SampleMaski`.
    Bits(u16),
    /// A share of the samples, 0 to 1: the first ones, or the others if it is inverted; OSG's `Multisample` with
    /// `GL_SAMPLE_COVERAGE`.
    Coverage {
        /// The share.
        share: f32,
        /// The samples that would not be drawn are drawn.
        is_inverted: bool,
    },
}

impl SampleMask {
    /// Returns the bits of the samples that are drawn, of a number of samples.
    pub(crate) fn bits(self, samples: u32) -> u16 {
        let all = u16::MAX >> (16 - samples.clamp(1, 16));
        match self {
            Self::Bits(bits) => bits & all,
            Self::Coverage { share, is_inverted } => {
                let count = (share.clamp(0.0, 1.0) * samples as f32).round() as u32;
                let first = if count == 0 { 0 } else { u16::MAX >> (16 - count.min(16)) };
                if is_inverted { all & !first } else { first & all }
            }
        }
    }
}

impl Default for SampleMask {
    /// Draws all samples.
    fn default() -> Self {
        Self::Bits(u16::MAX)
    }
}

/// Discards fragments by their alpha where [`Mode::AlphaTest`](super::Mode::AlphaTest) is on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlphaFunc {
    /// Compares alpha with the reference; fragments that pass are drawn.
    pub function: CompareFunction,
    /// The reference, 0 to 1.
    pub reference: f32,
}

impl Default for AlphaFunc {
    fn default() -> Self {
        Self { function: CompareFunction::Always, reference: 1.0 }
    }
}

/// An operation on a stencil value.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum StencilOperation {
    #[default]
    Keep,
    Zero,
    Replace,
    Invert,
    Increment,
    Decrement,
    IncrementWrap,
    DecrementWrap,
}

/// Stencil test of front or back faces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StencilFace {
    /// Compares the reference with the value in the target.
    pub function: CompareFunction,
    /// Operation where the stencil test fails.
    pub fail: StencilOperation,
    /// Operation where the depth test fails.
    pub depth_fail: StencilOperation,
    /// Operation where both tests pass.
    pub pass: StencilOperation,
}

impl Default for StencilFace {
    fn default() -> Self {
        Self {
            function: CompareFunction::Always,
            fail: StencilOperation::Keep,
            depth_fail: StencilOperation::Keep,
            pass: StencilOperation::Keep,
        }
    }
}

/// Stencil test and write, 8 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Stencil {
    /// Test of front faces.
    pub front: StencilFace,
    /// Test of back faces.
    pub back: StencilFace,
    /// The value that is compared, and that [`StencilOperation::Replace`] writes.
    pub reference: u8,
    /// Bits that are compared.
    pub read_mask: u8,
    /// Bits that are written.
    pub write_mask: u8,
}

impl Stencil {
    /// Uses the same test for both sides, with all bits.
    pub fn both(face: StencilFace, reference: u8) -> Self {
        Self { front: face, back: face, reference, read_mask: 0xff, write_mask: 0xff }
    }
}

impl Default for Stencil {
    fn default() -> Self {
        Self::both(StencilFace::default(), 0)
    }
}

/// The part of the target that is drawn to where [`Mode::ScissorTest`](super::Mode::ScissorTest) is on; pixels, origin upper
/// left.
#[allow(missing_docs, reason = "self-explaining")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Scissor {
    pub x: u32,
    pub y: u32,
    pub width: u32,
    pub height: u32,
}

/// The position of the image in the target; pixels, origin upper left.
#[allow(missing_docs, reason = "self-explaining")]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Viewport {
    pub x: f32,
    pub y: f32,
    pub width: f32,
    pub height: f32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_is_a_number_of_samples() {
        let of = |share, is_inverted, samples| SampleMask::Coverage { share, is_inverted }.bits(samples);
        assert_eq!([0.0, 0.25, 0.5, 1.0, 7.0, f32::NAN].map(|share| of(share, false, 4)), [0, 1, 3, 15, 15, 0]);
        assert_eq!([0.0, 0.25, 1.0].map(|share| of(share, true, 4)), [15, 14, 0]);
        assert_eq!((of(0.5, false, 16), of(1.0, false, 16), of(0.3, true, 1)), (0xff, 0xffff, 1));
        assert_eq!(SampleMask::Bits(0b1_0110).bits(4), 0b0110);
        assert_eq!(SampleMask::default().bits(8), 0xff);
    }
}
