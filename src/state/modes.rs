//! Modes, which switch parts of the pipeline on and off, and the flags of modes and attributes in a state set.

use std::ops::{BitAnd, BitOr};

/// Flags of a mode or an attribute in a state set; OSG's `StateAttribute::OverrideValue`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StateValue(u8);

impl StateValue {
    /// The mode is off.
    pub const OFF: Self = Self(0);
    /// The mode is on; the attribute applies.
    pub const ON: Self = Self(1);
    /// The value wins over everything below that is not protected.
    pub const OVERRIDE: Self = Self(2);
    /// The value applies even where a state set above overrides it.
    pub const PROTECTED: Self = Self(4);
    /// The value is ignored, as if it were absent.
    pub const INHERIT: Self = Self(8);

    /// Returns true if every flag of the other is set.
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

/// Number of texture units of a state set.
pub const TEXTURE_UNITS: usize = 4;
/// Number of lights of a render stage.
pub const LIGHTS: usize = 8;
/// Number of clip planes of a render stage.
pub const CLIP_PLANES: usize = 6;
/// Number of colour attachments of a target.
pub const COLOR_LOCATIONS: usize = 8;

/// A mode: a part of the pipeline that is switched on or off. Each variant names its default.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Blending; off, and on for drawables whose material blends.
    Blend,
    /// Culling of faces; on, and off for drawables with a double-sided material.
    CullFace,
    /// Depth test, and with it depth writes; on.
    DepthTest,
    /// [`PolygonOffset`](super::PolygonOffset); off.
    PolygonOffset,
    /// Lighting; on, and off for drawables with an unlit material.
    Lighting,
    /// Fog: the attribute [`Fog`](super::Fog) if present, otherwise the environment's haze; on.
    Fog,
    /// [`AlphaFunc`](super::AlphaFunc); off.
    AlphaTest,
    /// [`Stencil`](super::Stencil); off.
    StencilTest,
    /// [`Scissor`](super::Scissor); off.
    ScissorTest,
    /// Derives the coverage of multisampled targets from alpha; off.
    AlphaToCoverage,
    /// A light by its number, 0 to 7; off, except for light 0. That is the sun and the sky of the
    /// [`Environment`](crate::scene::Environment), unless a LightSource with that number replaces it.
    Light(u8),
    /// A clip plane by its number, 0 to 5; off.
    ClipPlane(u8),
    /// A texture unit, 0 to 3; off. Unit 0 switched off with override also disables the textures of drawables' own
    /// materials. The fixed function supports one cube, one volume and one array: further ones are white, and the renderer
    /// reports that.
    Texture(u8),
    /// [`TexGen`](super::TexGen) of a texture unit; off.
    TexGen(u8),
    /// [`SampleMask`](super::SampleMask); off.
    SampleMask,
}

impl Mode {
    /// The number of modes.
    pub const COUNT: usize = 11 + LIGHTS + CLIP_PLANES + 2 * TEXTURE_UNITS;
    /// The modes that are on by default, as bits of [`Self::index`].
    pub(crate) const ON_BY_DEFAULT: u64 = 1 << 1 | 1 << 2 | 1 << 4 | 1 << 5 | 1 << 10;

    /// The modes that need the fixed function when they differ from their defaults: fog, alpha test, lights, clip planes
    /// and texture units.
    pub(crate) const OF_FIXED_FUNCTION: u64 =
        1 << 5 | 1 << 6 | ((1 << (LIGHTS + CLIP_PLANES + TEXTURE_UNITS)) - 1) << 10;

    /// Returns a number below [`Self::COUNT`] that is unique to the mode, or `None` for a light, plane or unit whose number
    /// is out of range.
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
            Self::SampleMask => units + 2 * TEXTURE_UNITS,
        })
    }

    /// Returns an error for a light, plane or unit whose number is out of range.
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

/// The number of a light, clip plane, texture unit or attachment is out of range. The setting is ignored, and the renderer
/// reports the state set or node that contains it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} {number} is out of range: numbers are 0 to {last}", last = count - 1)]
pub struct NumberError {
    /// The kind: light, clip plane, texture unit or attachment.
    pub what: &'static str,
    /// The number that was given.
    pub number: u8,
    /// The number of valid numbers, which start at 0.
    pub count: usize,
}
