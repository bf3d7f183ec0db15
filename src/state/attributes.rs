//! Modes and attributes: what a state set can say about how things are drawn, in OpenGL's and OSG's terms.

use std::ops::{BitAnd, BitOr};
use std::sync::Arc;

use super::lighting::{Fog, LightModel, SurfaceMaterial};
use super::program::Program;
use super::texture::TextureBinding;

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

/// Texture units of a state set.
pub const TEXTURE_UNITS: usize = 4;
/// Lights of a render stage.
pub const LIGHTS: usize = 8;
/// Clip planes of a render stage.
pub const CLIP_PLANES: usize = 6;

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
    /// Light; on, and off for drawables with an unlit material.
    Lighting,
    /// Haze, or the [`Fog`] that is given; on.
    Fog,
    /// [`AlphaFunc`]; off.
    AlphaTest,
    /// [`Stencil`]; off.
    StencilTest,
    /// [`Scissor`]; off.
    ScissorTest,
    /// Coverage of multisampled targets from alpha; off.
    AlphaToCoverage,
    /// A light by its number, 0 to 7. Light 0 is on: the sun and the sky of the
    /// [`Environment`](crate::draw::Environment), until a LightSource with that number takes its place.
    Light(u8),
    /// A clip plane by its number, 0 to 5; off.
    ClipPlane(u8),
    /// A texture unit, 0 to 3; off. Unit 0 switched off with override takes the textures of drawables' own materials
    /// along. Of cubes, volumes and arrays the fixed function takes one each: units after the first with another are
    /// white, and that is said.
    Texture(u8),
    /// [`TexGen`] of a texture unit; off.
    TexGen(u8),
}

impl Mode {
    /// How many there are.
    pub const COUNT: usize = 10 + LIGHTS + CLIP_PLANES + 2 * TEXTURE_UNITS;
    /// Those that are on by default, as bits of [`Self::index`].
    pub(crate) const ON_BY_DEFAULT: u64 = 1 << 1 | 1 << 2 | 1 << 4 | 1 << 5 | 1 << 10;

    /// Those that need the fixed function when they are not as by default: fog, alpha test, lights, clip planes,
    /// texture units.
    pub(crate) const OF_FIXED_FUNCTION: u64 =
        1 << 5 | 1 << 6 | ((1 << (LIGHTS + CLIP_PLANES + TEXTURE_UNITS)) - 1) << 10;

    /// A number of its own below [`Self::COUNT`]; none for a light, plane or unit that there is not.
    pub fn index(self) -> Option<usize> {
        let at = |first: usize, number: u8, count: usize| {
            let number = usize::from(number);
            (number < count).then_some(first + number)
        };
        let planes = 10 + LIGHTS;
        let units = planes + CLIP_PLANES;
        Some(match self {
            Self::Blend => 0,
            Self::CullFace => 1,
            Self::DepthTest => 2,
            Self::PolygonOffset => 3,
            Self::Lighting => 4,
            Self::Fog => 5,
            Self::AlphaTest => 6,
            Self::StencilTest => 7,
            Self::ScissorTest => 8,
            Self::AlphaToCoverage => 9,
            Self::Light(number) => return at(10, number, LIGHTS),
            Self::ClipPlane(number) => return at(planes, number, CLIP_PLANES),
            Self::Texture(unit) => return at(units, unit, TEXTURE_UNITS),
            Self::TexGen(unit) => return at(units + TEXTURE_UNITS, unit, TEXTURE_UNITS),
        })
    }

    /// An error for a light, plane or unit that there is not.
    pub fn check(self) -> Result<(), NumberError> {
        let (what, number, count) = match self {
            Self::Light(number) => ("light", number, LIGHTS),
            Self::ClipPlane(number) => ("clip plane", number, CLIP_PLANES),
            Self::Texture(unit) | Self::TexGen(unit) => ("texture unit", unit, TEXTURE_UNITS),
            _ => return Ok(()),
        };
        if usize::from(number) < count { Ok(()) } else { Err(NumberError { what, number, count }) }
    }
}

/// A light, clip plane or texture unit by a number beyond the last one. What is said of it does not count; the renderer
/// tells which state set or node said it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} {number} is not there: numbers are 0 to {last}", last = count - 1)]
pub struct NumberError {
    /// What is numbered.
    pub what: &'static str,
    /// The number given.
    pub number: u8,
    /// How many there are.
    pub count: usize,
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
    /// The [`Attribute::BlendColor`].
    ConstantColor,
    OneMinusConstantColor,
}

/// How source and destination are weighed: colour, and alpha where the target keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlendFunc {
    /// Of the colour of what is drawn.
    pub source: BlendFactor,
    /// Of the colour that is there.
    pub destination: BlendFactor,
    /// Of the alpha of what is drawn.
    pub source_alpha: BlendFactor,
    /// Of the alpha that is there.
    pub destination_alpha: BlendFactor,
}

impl BlendFunc {
    /// `SRC_ALPHA, ONE_MINUS_SRC_ALPHA`: the default.
    pub const ALPHA: Self = Self::new(BlendFactor::SrcAlpha, BlendFactor::OneMinusSrcAlpha);
    /// `ONE, ONE`: light is added.
    pub const ADD: Self = Self::new(BlendFactor::One, BlendFactor::One);

    /// The same for colour and alpha.
    pub const fn new(source: BlendFactor, destination: BlendFactor) -> Self {
        Self { source, destination, source_alpha: source, destination_alpha: destination }
    }

    /// The same for colour, others for alpha.
    pub const fn with_alpha(self, source_alpha: BlendFactor, destination_alpha: BlendFactor) -> Self {
        Self { source_alpha, destination_alpha, ..self }
    }

    /// One of the factors is the [`Attribute::BlendColor`].
    pub(crate) fn has_constant(&self) -> bool {
        let factors = [self.source, self.destination, self.source_alpha, self.destination_alpha];
        factors.iter().any(|f| matches!(f, BlendFactor::ConstantColor | BlendFactor::OneMinusConstantColor))
    }
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
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Depth {
    /// Compares what is drawn with what is there.
    pub function: CompareFunction,
    /// Whether what passes is written.
    pub write: bool,
    /// Depths of the near plane and of infinity, 0 to 1: `[0, 0.1]` is before everything that has `[0.1, 1]`.
    pub range: [f32; 2],
}

impl Default for Depth {
    fn default() -> Self {
        Self { function: CompareFunction::Less, write: true, range: [0.0, 1.0] }
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

/// Drops fragments by their alpha where [`Mode::AlphaTest`] is on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlphaFunc {
    /// Compares alpha with the reference; what passes is drawn.
    pub function: CompareFunction,
    /// 0 to 1.
    pub reference: f32,
}

impl Default for AlphaFunc {
    fn default() -> Self {
        Self { function: CompareFunction::Always, reference: 1.0 }
    }
}

/// What happens to a stencil value.
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
    /// Compares the reference with what is there.
    pub function: CompareFunction,
    /// Where the stencil test fails.
    pub fail: StencilOperation,
    /// Where the depth test fails.
    pub depth_fail: StencilOperation,
    /// Where both pass.
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
    /// Of front faces.
    pub front: StencilFace,
    /// Of back faces.
    pub back: StencilFace,
    /// What is compared and what [`StencilOperation::Replace`] writes.
    pub reference: u8,
    /// Bits that are compared.
    pub read_mask: u8,
    /// Bits that are written.
    pub write_mask: u8,
}

impl Stencil {
    /// The same for both sides, with all bits.
    pub fn both(face: StencilFace, reference: u8) -> Self {
        Self { front: face, back: face, reference, read_mask: 0xff, write_mask: 0xff }
    }
}

impl Default for Stencil {
    fn default() -> Self {
        Self::both(StencilFace::default(), 0)
    }
}

/// The part of the target that is drawn to where [`Mode::ScissorTest`] is on; pixels, origin upper left.
#[allow(missing_docs, reason = "self-explaining")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Scissor {
    pub x: u32,
    pub y: u32,
    pub width: u32,
    pub height: u32,
}

/// Where the picture lies in the target; pixels, origin upper left.
#[allow(missing_docs, reason = "self-explaining")]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Viewport {
    pub x: f32,
    pub y: f32,
    pub width: f32,
    pub height: f32,
}

/// Where texture coordinates come from; OpenGL's `glTexGen`.
///
/// Planes are those of s, t, r and q. Planes and volumes are read at the others divided by q, so that a picture can be
/// projected; cubes in the direction of s, t and r; arrays at s and t divided by q in the layer nearest to r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TexGen {
    /// Distances from planes of the drawable's frame.
    ObjectLinear([[f32; 4]; 4]),
    /// Distances from planes of the eye's frame, or of a TexGenNode's.
    EyeLinear([[f32; 4]; 4]),
    /// The point of a photographed mirror ball that reflects the same.
    SphereMap,
    /// The normal in the eye's frame.
    NormalMap,
    /// The mirrored view direction in the eye's frame.
    ReflectionMap,
}

impl TexGen {
    /// All four planes of pictures that are not projected: r is 0 everywhere, and q is 1.
    pub const fn planes(s: [f32; 4], t: [f32; 4]) -> [[f32; 4]; 4] {
        [s, t, [0.0; 4], [0.0, 0.0, 0.0, 1.0]]
    }
}

/// One attribute of a state set.
#[allow(missing_docs, reason = "each is the type of its name")]
#[derive(Clone, Debug, PartialEq)]
pub enum Attribute {
    BlendFunc(BlendFunc),
    BlendEquation(BlendEquation),
    /// Linear, for [`BlendFactor::ConstantColor`].
    BlendColor([f32; 4]),
    Depth(Depth),
    CullFace(CullFace),
    FrontFace(FrontFace),
    PolygonMode(PolygonMode),
    PolygonOffset(PolygonOffset),
    ColorMask(ColorMask),
    AlphaFunc(AlphaFunc),
    Stencil(Stencil),
    Scissor(Scissor),
    Viewport(Viewport),
    /// Of both sides.
    SurfaceMaterial(SurfaceMaterial),
    /// Of each side, in place of one for both: the back has its own where light falls on both ([`LightModel::two_sided`]).
    SurfaceMaterials {
        front: SurfaceMaterial,
        back: SurfaceMaterial,
    },
    LightModel(LightModel),
    Fog(Fog),
    /// Of a unit.
    TexGen(u8, TexGen),
    /// At a unit.
    Texture(u8, TextureBinding),
    Program(Arc<Program>),
}

impl Attribute {
    /// The mode that [`super::StateSet::set_attribute_and_modes`] switches with the attribute.
    pub fn mode(&self) -> Option<Mode> {
        match self {
            Self::BlendFunc(_) | Self::BlendEquation(_) | Self::BlendColor(_) => Some(Mode::Blend),
            Self::Depth(_) => Some(Mode::DepthTest),
            Self::CullFace(_) => Some(Mode::CullFace),
            Self::PolygonOffset(_) => Some(Mode::PolygonOffset),
            Self::AlphaFunc(_) => Some(Mode::AlphaTest),
            Self::Stencil(_) => Some(Mode::StencilTest),
            Self::Scissor(_) => Some(Mode::ScissorTest),
            Self::Fog(_) => Some(Mode::Fog),
            Self::TexGen(unit, _) => Some(Mode::TexGen(*unit)),
            Self::Texture(unit, _) => Some(Mode::Texture(*unit)),
            Self::FrontFace(_)
            | Self::PolygonMode(_)
            | Self::ColorMask(_)
            | Self::Viewport(_)
            | Self::SurfaceMaterial(_)
            | Self::SurfaceMaterials { .. }
            | Self::LightModel(_)
            | Self::Program(_) => None,
        }
    }

    /// Two attributes of which a state set holds only one.
    pub(super) fn is_same_kind(&self, other: &Self) -> bool {
        match (self, other) {
            (
                Self::SurfaceMaterial(_) | Self::SurfaceMaterials { .. },
                Self::SurfaceMaterial(_) | Self::SurfaceMaterials { .. },
            ) => true,
            (Self::TexGen(a, _), Self::TexGen(b, _)) | (Self::Texture(a, _), Self::Texture(b, _)) => a == b,
            _ => std::mem::discriminant(self) == std::mem::discriminant(other),
        }
    }
}
