//! Textures of state sets: images, or targets that cameras draw into; and how they are sampled.
//!
//! Shared by identity: every state set that holds the same `Arc` uses one texture of the context. It is freed when
//! the last `Arc` is gone.

use std::sync::Arc;

use super::attributes::CompareFunction;

/// How texels are addressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TextureDimension {
    /// A row.
    D1,
    /// A picture.
    #[default]
    D2,
    /// Pictures by layer.
    D2Array,
    /// Six faces: +x, -x, +y, -y, +z, -z.
    Cube,
    /// A volume.
    D3,
}

/// What a texel holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TextureFormat {
    /// Four bytes, sRGB colour and linear alpha.
    #[default]
    Rgba8Srgb,
    /// Four bytes, linear.
    Rgba8,
    /// One byte, linear.
    R8,
    /// Four half floats.
    Rgba16Float,
    /// One float.
    R32Float,
    /// Depth, for targets only.
    Depth32,
    /// Depth in at least 24 bits beside the stencil, for targets only; sampled as depth.
    Depth24Stencil8,
    /// Depth as precise as the renderer's own beside the stencil, for targets only, where the adapter has it; sampled as
    /// depth.
    Depth32Stencil8,
}

impl TextureFormat {
    /// Bytes of a texel.
    pub const fn texel_bytes(self) -> usize {
        match self {
            Self::R8 => 1,
            Self::Rgba16Float | Self::Depth32Stencil8 => 8,
            _ => 4,
        }
    }

    /// It holds depth, and may hold stencil.
    pub const fn is_depth(self) -> bool {
        matches!(self, Self::Depth32) || self.has_stencil()
    }

    /// It holds stencil beside depth.
    pub const fn has_stencil(self) -> bool {
        matches!(self, Self::Depth24Stencil8 | Self::Depth32Stencil8)
    }
}

/// A texture by its contents or, without any, one to draw into.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureObject {
    /// For people, and for errors.
    pub name: String,
    /// How it is addressed.
    pub dimension: TextureDimension,
    /// Width, height, and layers, faces (6) or depth of level 0.
    pub size: [u32; 3],
    /// What a texel holds.
    pub format: TextureFormat,
    /// Mip levels, each half the size of the one before.
    pub levels: u32,
    /// Texels by level, all layers of a level together; empty for a target.
    pub texels: Vec<Vec<u8>>,
    /// What it shows changes, as an [`ImageSequence`](crate::pager::ImageSequence)'s does: which one it is matters, and
    /// none of the same contents takes its place.
    pub is_changing: bool,
}

impl TextureObject {
    /// A picture of one level.
    pub fn image(name: &str, size: [u32; 2], rgba: Vec<u8>) -> Arc<Self> {
        Arc::new(Self {
            name: name.into(),
            dimension: TextureDimension::D2,
            size: [size[0], size[1], 1],
            format: TextureFormat::Rgba8Srgb,
            levels: 1,
            texels: vec![rgba],
            is_changing: false,
        })
    }

    /// A picture for cameras to draw into.
    pub fn target(name: &str, size: [u32; 2], format: TextureFormat) -> Arc<Self> {
        Arc::new(Self {
            name: name.into(),
            dimension: TextureDimension::D2,
            size: [size[0], size[1], 1],
            format,
            levels: 1,
            texels: Vec::new(),
            is_changing: false,
        })
    }

    /// Size of a level.
    pub fn level_size(&self, level: u32) -> [u32; 3] {
        let [w, h, d] = self.size;
        let half = |side: u32| (side >> level.min(31)).max(1);
        let depth = if self.dimension == TextureDimension::D3 { half(d) } else { d };
        [half(w), if self.dimension == TextureDimension::D1 { 1 } else { half(h) }, depth]
    }

    /// What is wrong with it, if anything: sizes that do not fit together, missing texels.
    pub fn problem(&self) -> Option<String> {
        let [w, h, d] = self.size;
        let layers_fit = match self.dimension {
            TextureDimension::D1 => h == 1 && d == 1,
            TextureDimension::D2 => d == 1,
            TextureDimension::Cube => d == 6 && w == h,
            TextureDimension::D2Array | TextureDimension::D3 => true,
        };
        if w == 0 || h == 0 || d == 0 || !layers_fit {
            return Some(format!("texture {:?}: {w} x {h} x {d} is no size of {:?}", self.name, self.dimension));
        }
        let largest = if self.dimension == TextureDimension::D3 { w.max(h).max(d) } else { w.max(h) };
        if self.levels == 0 || self.levels > 32 - largest.leading_zeros() {
            return Some(format!("texture {:?}: {} levels of {w} x {h}", self.name, self.levels));
        }
        if self.texels.is_empty() {
            return None;
        }
        if self.texels.len() != self.levels as usize || self.format.is_depth() {
            return Some(format!("texture {:?}: texels of {} levels", self.name, self.texels.len()));
        }
        (0..self.levels).zip(&self.texels).find_map(|(level, texels)| {
            let [w, h, d] = self.level_size(level).map(u64::from);
            let want = w * h * d * self.format.texel_bytes() as u64;
            let got = texels.len() as u64;
            let name = &self.name;
            (got != want).then(|| format!("texture {name:?}: level {level} has {got} bytes instead of {want}"))
        })
    }
}

/// Between texels.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum FilterMode {
    Nearest,
    #[default]
    Linear,
}

/// Beyond the edges.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum WrapMode {
    #[default]
    ClampToEdge,
    Repeat,
    Mirror,
}

/// Clamped along both axes of a picture.
pub(crate) const CLAMPED: [WrapMode; 2] = [WrapMode::ClampToEdge; 2];

/// How a texture is sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampler {
    /// Where a texel covers less than a pixel.
    pub min_filter: FilterMode,
    /// Where it covers more.
    pub mag_filter: FilterMode,
    /// Between mip levels.
    pub mip_filter: FilterMode,
    /// Along s, t and r.
    pub wrap: [WrapMode; 3],
    /// Most samples along the steepest direction, 1 to 16; counts where all filters are linear.
    pub max_anisotropy: u8,
    /// Added to the mip level by the fixed function. Adapters' samplers have none: programs do not see it, theirs is
    /// what they give `textureSampleBias`.
    pub mip_bias: f32,
    /// Compares with a reference instead of returning depth; programs only.
    pub compare: Option<CompareFunction>,
}

impl Default for Sampler {
    fn default() -> Self {
        Self {
            min_filter: FilterMode::Linear,
            mag_filter: FilterMode::Linear,
            mip_filter: FilterMode::Linear,
            wrap: [WrapMode::ClampToEdge; 3],
            max_anisotropy: 1,
            mip_bias: 0.0,
            compare: None,
        }
    }
}

/// A texture with its sampler, at a unit of a state set.
#[derive(Clone, Debug)]
pub struct TextureBinding {
    /// Texels.
    pub texture: Arc<TextureObject>,
    /// How they are read.
    pub sampler: Sampler,
}

impl TextureBinding {
    /// Sampled linearly, clamped.
    pub fn new(texture: Arc<TextureObject>) -> Self {
        Self { texture, sampler: Sampler::default() }
    }
}

impl PartialEq for TextureBinding {
    /// By identity of the texture.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.texture, &other.texture) && self.sampler == other.sampler
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_texels_are_checked() {
        let good = TextureObject::image("good", [4, 2], vec![0; 32]);
        assert_eq!(good.problem(), None);
        assert_eq!(good.level_size(1), [2, 1, 1]);
        let change = |f: fn(&mut TextureObject)| {
            let mut changed = (*good).clone();
            f(&mut changed);
            changed.problem()
        };
        assert!(change(|t| t.size = [0, 2, 1]).is_some());
        assert!(change(|t| t.texels[0].truncate(31)).unwrap_or_default().contains("31 bytes instead of 32"));
        assert!(change(|t| t.levels = 4).is_some());
        assert!(change(|t| t.dimension = TextureDimension::Cube).is_some());
        assert!(change(|t| t.levels = 2).is_some(), "texels of one level only");
        assert!(change(|t| t.texels.clear()).is_none());
    }
}
