//! Textures and materials as plain CPU data.

use std::sync::Arc;

use crate::state::WrapMode;

/// An RGBA8 sRGB image with its mip levels, level 0 first, each half the size of the one before (at least 1).
#[derive(Clone, PartialEq)]
pub struct Texture {
    /// Width of level 0 in texels.
    pub width: u32,
    /// Height of level 0 in texels.
    pub height: u32,
    /// Rows top to bottom, 4 bytes a texel; one entry per level.
    pub mips: Vec<Vec<u8>>,
    /// How texture coordinates outside 0..1 wrap, along u and along v.
    pub wrap: [WrapMode; 2],
}

impl std::fmt::Debug for Texture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Texture({}x{}, {} mips)", self.width, self.height, self.mips.len())
    }
}

/// How alpha is used; glTF's `alphaMode`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Fragments with alpha below the cutoff are discarded.
    Mask(f32),
    /// The material is blended over what is behind it, in the depth-sorted transparent bin.
    Blend,
}

/// The surface of a drawable: the part of glTF's material that is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// A linear RGBA factor.
    pub base_color: [f32; 4],
    /// A texture that is multiplied by the factor.
    pub texture: Option<Arc<Texture>>,
    /// How alpha is used.
    pub alpha: AlphaMode,
    /// If true, back faces are drawn too.
    pub double_sided: bool,
    /// If true, the surface is not lit (KHR_materials_unlit).
    pub unlit: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self { base_color: [1.0; 4], texture: None, alpha: AlphaMode::Opaque, double_sided: false, unlit: false }
    }
}
