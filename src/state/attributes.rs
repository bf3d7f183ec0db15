//! [`Attribute`]: a parameter of how drawables are drawn, in the terms of OpenGL and OSG.

use std::sync::Arc;

use super::lighting::{Fog, LightModel, SurfaceMaterial};
use super::modes::Mode;
use super::program::Program;
use super::raster::{
    AlphaFunc, BlendEquation, BlendFunc, ColorMask, CullFace, Depth, FrontFace, PolygonMode, PolygonOffset, Scissor,
    Stencil, Viewport,
};
use super::texgen::TexGen;
use super::texture::TextureBinding;

/// One attribute of a state set.
#[allow(missing_docs, reason = "each is the type of its name")]
#[derive(Clone, Debug, PartialEq)]
pub enum Attribute {
    BlendFunc(BlendFunc),
    BlendEquation(BlendEquation),
    /// Linear colour for `BlendFactor::ConstantColor`.
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
    Program(Arc<Program>),
}

impl Attribute {
    /// Returns the mode that [`super::StateSet::set_attribute_and_modes`] switches with the attribute.
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

    /// Returns true if a state set holds only one of the two attributes.
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
