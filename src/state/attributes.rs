//! Modes and attributes: what a state set can say about how things are drawn, in OpenGL's and OSG's terms.

use std::ops::{BitAnd, BitOr};

/// How a mode or an attribute is given; OSG's `StateAttribute::OverrideValue`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StateValue(u8);

impl StateValue {
    /// The mode is off.
    pub const OFF: Self = Self(0);
    /// The mode is on; the attribute counts.
    pub const ON: Self = Self(1);
    /// Holds for everything below that is not protected.
    pub const OVERRIDE: Self = Self(2);
    /// Holds whatever above overrides.
    pub const PROTECTED: Self = Self(4);
    /// As if it were not there.
    pub const INHERIT: Self = Self(8);

    /// True when every flag of the other is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl BitOr for StateValue {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitAnd for StateValue {
    type Output = Self;
    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

/// What is switched on and off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Blending; off, and on for drawables whose material blends.
    Blend,
    /// Culling of faces; on, and off for drawables with a double-sided material.
    CullFace,
    /// Depth test, and with it depth writes; on.
    DepthTest,
    /// [`PolygonOffset`]; off.
    PolygonOffset,
}

impl Mode {
    /// All of them, in the order of their discriminants.
    pub const ALL: [Self; 4] = [Self::Blend, Self::CullFace, Self::DepthTest, Self::PolygonOffset];
}

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
}

/// How source and destination are weighed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlendFunc {
    /// Of what is drawn.
    pub source: BlendFactor,
    /// Of what is there.
    pub destination: BlendFactor,
}

impl BlendFunc {
    /// `SRC_ALPHA, ONE_MINUS_SRC_ALPHA`: the default.
    pub const ALPHA: Self = Self { source: BlendFactor::SrcAlpha, destination: BlendFactor::OneMinusSrcAlpha };
    /// `ONE, ONE`: light is added.
    pub const ADD: Self = Self { source: BlendFactor::One, destination: BlendFactor::One };
}

/// How the weighed source and destination are put together.
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

/// When a comparison passes.
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

/// Depth test and depth writes. `Less` passes what is nearer to the eye, as in OpenGL; that depths are stored
/// reversed does not show here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Depth {
    /// Compares what is drawn with what is there.
    pub function: CompareFunction,
    /// Whether what passes is written.
    pub write: bool,
}

impl Default for Depth {
    fn default() -> Self {
        Self { function: CompareFunction::Less, write: true }
    }
}

/// Which faces are not drawn where [`Mode::CullFace`] is on.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CullFace {
    Front,
    #[default]
    Back,
    FrontAndBack,
}

/// Which way the corners of a front face go round.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum FrontFace {
    #[default]
    CounterClockwise,
    Clockwise,
}

/// How triangles are rasterised; lines and points only where the adapter can, else filled.
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
    /// Per slope.
    pub factor: f32,
    /// In the smallest steps of the depth buffer.
    pub units: f32,
}

/// Which components are written: red, green, blue. Alpha stays the cleared 1, so that pictures are opaque.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ColorMask(pub [bool; 3]);

impl Default for ColorMask {
    fn default() -> Self {
        Self([true; 3])
    }
}

/// One attribute of a state set.
#[allow(missing_docs, reason = "each is the type of its name")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Attribute {
    BlendFunc(BlendFunc),
    BlendEquation(BlendEquation),
    Depth(Depth),
    CullFace(CullFace),
    FrontFace(FrontFace),
    PolygonMode(PolygonMode),
    PolygonOffset(PolygonOffset),
    ColorMask(ColorMask),
}

impl Attribute {
    /// The mode that [`super::StateSet::set_attribute_and_modes`] switches with the attribute.
    pub fn mode(&self) -> Option<Mode> {
        match self {
            Self::BlendFunc(_) | Self::BlendEquation(_) => Some(Mode::Blend),
            Self::Depth(_) => Some(Mode::DepthTest),
            Self::CullFace(_) => Some(Mode::CullFace),
            Self::PolygonOffset(_) => Some(Mode::PolygonOffset),
            Self::FrontFace(_) | Self::PolygonMode(_) | Self::ColorMask(_) => None,
        }
    }
}
