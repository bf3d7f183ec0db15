//! [`Attribute`]: a parameter of how drawables are drawn, in the terms of OpenGL and OSG.

use std::sync::Arc;

use super::hook::OpaqueDrawData;
use super::lighting::{Fog, Light, LightModel, SurfaceMaterial};
use super::modes::{COLOR_LOCATIONS, Mode, NumberError};
use super::program::Program;
use super::raster::{
    AlphaFunc, BlendEquation, BlendFunc, ColorMask, CullFace, Depth, FrontFace, PolygonMode, PolygonOffset, SampleMask,
    Scissor, Stencil, Viewport,
};
use super::texture::TextureBinding;
use super::texture_units::{TexEnv, TexGen};

/// One attribute of a state set.
#[allow(missing_docs, reason = "each is the type of its name")]
#[derive(Clone, Debug, PartialEq)]
pub enum Attribute {
    BlendFunc(BlendFunc),
    BlendEquation(BlendEquation),
    /// The factors of one colour attachment, 0 to 7, instead of [`Self::BlendFunc`]. Factors of ONE and ZERO blend nothing.
    BlendFuncOf(u8, BlendFunc),
    /// The operation of one colour attachment, instead of [`Self::BlendEquation`].
    BlendEquationOf(u8, BlendEquation),
    /// Linear colour for `BlendFactor::ConstantColor`.
    BlendColor([f32; 4]),
    Depth(Depth),
    CullFace(CullFace),
    FrontFace(FrontFace),
    PolygonMode(PolygonMode),
    PolygonOffset(PolygonOffset),
    ColorMask(ColorMask),
    /// The components of one colour attachment, 0 to 7, instead of [`Self::ColorMask`].
    ColorMaskOf(u8, ColorMask),
    SampleMask(SampleMask),
    AlphaFunc(AlphaFunc),
    Stencil(Stencil),
    Scissor(Scissor),
    Viewport(Viewport),
    /// The same material for both sides.
    SurfaceMaterial(SurfaceMaterial),
    /// One material for each side. That of the back needs lighting of both sides ([`LightModel::two_sided`]).
    SurfaceMaterials {
        front: SurfaceMaterial,
        back: SurfaceMaterial,
    },
    LightModel(LightModel),
    Fog(Fog),
    /// The generator of a texture unit.
    TexGen(u8, TexGen),
    /// The texture of a unit.
    Texture(u8, TextureBinding),
    /// How the texture of a unit changes the colour.
    TexEnv(u8, TexEnv),
    /// A matrix, by columns, for the coordinates s, t, r and q of a unit, also for generated ones. As everywhere in Terrane,
    /// t goes down from the first row of an image.
    TexMat(u8, [[f32; 4]; 4]),
    /// A light that moves with the eye, for what the state set holds for: position and direction are in eye space. The
    /// default one is OSG's headlight. It replaces the LightSource of its number.
    Light(Light),
    /// A clip plane of a number that moves with the eye: a point `p` of eye space is kept if `normal . p + d >= 0`. It
    /// replaces the plane of a ClipNode of its number.
    ClipPlane(u8, [f64; 4]),
    Program(Arc<Program>),
    /// An attribute of the application's own, which binds buffers and textures for the program: `draw::state_attribute`
    /// creates it. Compared by identity.
    Custom(OpaqueDrawData),
}

impl Attribute {
    /// Returns the mode that [`super::StateSet::set_attribute_and_modes`] switches with the attribute.
    pub fn mode(&self) -> Option<Mode> {
        match self {
            Self::BlendFunc(_)
            | Self::BlendEquation(_)
            | Self::BlendFuncOf(..)
            | Self::BlendEquationOf(..)
            | Self::BlendColor(_) => Some(Mode::Blend),
            Self::SampleMask(_) => Some(Mode::SampleMask),
            Self::Depth(_) => Some(Mode::DepthTest),
            Self::CullFace(_) => Some(Mode::CullFace),
            Self::PolygonOffset(_) => Some(Mode::PolygonOffset),
            Self::AlphaFunc(_) => Some(Mode::AlphaTest),
            Self::Stencil(_) => Some(Mode::StencilTest),
            Self::Scissor(_) => Some(Mode::ScissorTest),
            Self::Fog(_) => Some(Mode::Fog),
            Self::TexGen(unit, _) => Some(Mode::TexGen(*unit)),
            Self::Texture(unit, _) => Some(Mode::Texture(*unit)),
            Self::Light(light) => Some(Mode::Light(light.number)),
            Self::ClipPlane(number, _) => Some(Mode::ClipPlane(*number)),
            Self::FrontFace(_)
            | Self::PolygonMode(_)
            | Self::ColorMask(_)
            | Self::ColorMaskOf(..)
            | Self::Viewport(_)
            | Self::SurfaceMaterial(_)
            | Self::SurfaceMaterials { .. }
            | Self::LightModel(_)
            | Self::TexEnv(..)
            | Self::TexMat(..)
            | Self::Program(_)
            | Self::Custom(_) => None,
        }
    }

    /// Returns an error for an attribute of a light, plane, unit or attachment whose number is out of range.
    pub(super) fn check(&self) -> Result<(), NumberError> {
        match self {
            Self::BlendFuncOf(location, _) | Self::BlendEquationOf(location, _) | Self::ColorMaskOf(location, _) => {
                let is_known = usize::from(*location) < COLOR_LOCATIONS;
                let error = NumberError { what: "colour attachment", number: *location, count: COLOR_LOCATIONS };
                if is_known { Ok(()) } else { Err(error) }
            }
            Self::TexEnv(unit, _) | Self::TexMat(unit, _) => Mode::Texture(*unit).check(),
            _ => self.mode().map_or(Ok(()), Mode::check),
        }
    }

    /// Returns true if a state set holds only one of the two attributes.
    pub(super) fn is_same_kind(&self, other: &Self) -> bool {
        match (self, other) {
            (
                Self::SurfaceMaterial(_) | Self::SurfaceMaterials { .. },
                Self::SurfaceMaterial(_) | Self::SurfaceMaterials { .. },
            ) => true,
            (Self::TexGen(a, _), Self::TexGen(b, _))
            | (Self::Texture(a, _), Self::Texture(b, _))
            | (Self::TexEnv(a, _), Self::TexEnv(b, _))
            | (Self::TexMat(a, _), Self::TexMat(b, _))
            | (Self::ClipPlane(a, _), Self::ClipPlane(b, _))
            | (Self::BlendFuncOf(a, _), Self::BlendFuncOf(b, _))
            | (Self::BlendEquationOf(a, _), Self::BlendEquationOf(b, _))
            | (Self::ColorMaskOf(a, _), Self::ColorMaskOf(b, _)) => a == b,
            (Self::Light(a), Self::Light(b)) => a.number == b.number,
            _ => std::mem::discriminant(self) == std::mem::discriminant(other),
        }
    }
}
