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

    /// Returns true if one of the factors is the [`Attribute::BlendColor`](super::Attribute::BlendColor).
    pub(crate) fn has_constant(&self) -> bool {
        let factors = [self.source, self.destination, self.source_alpha, self.destination_alpha];
        factors.iter().any(|f| matches!(f, BlendFactor::ConstantColor | BlendFactor::OneMinusConstantColor))
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

/// The components that are written: red, green, blue. Alpha stays the cleared 1, so that images are opaque.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ColorMask(pub [bool; 3]);

impl Default for ColorMask {
    fn default() -> Self {
        Self([true; 3])
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

/// The part of the target that is drawn to where [`Mode::ScissorTest`](super::Mode::ScissorTest) is on; pixels, origin upper left.
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
