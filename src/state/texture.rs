//! Textures of state sets: images, or targets that cameras draw into, with their samplers.
//!
//! They are shared by identity: all state sets that hold the same `Arc` use one texture of the context, which is freed
//! after the last `Arc` was dropped.

use std::sync::Arc;

use super::raster::CompareFunction;

/// The dimension of a texture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TextureDimension {
    /// A row of texels.
    D1,
    /// An image.
    #[default]
    D2,
    /// An array of images.
    D2Array,
    /// Six faces: +x, -x, +y, -y, +z, -z.
    Cube,
    /// A volume.
    D3,
}

/// The format of a texel.
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
    /// Depth in the renderer's own precision beside the stencil, for targets only; sampled as depth. Needs support by the
    /// adapter.
    Depth32Stencil8,
}

impl TextureFormat {
    /// Returns the size of a texel in bytes.
    pub const fn texel_bytes(self) -> usize {
        match self {
            Self::R8 => 1,
            Self::Rgba16Float | Self::Depth32Stencil8 => 8,
            _ => 4,
        }
    }

    /// Returns true if it holds depth, with or without stencil.
    pub const fn is_depth(self) -> bool {
        matches!(self, Self::Depth32) || self.has_stencil()
    }

    /// Returns true if it holds stencil beside depth.
    pub const fn has_stencil(self) -> bool {
        matches!(self, Self::Depth24Stencil8 | Self::Depth32Stencil8)
    }
}

/// A texture with its contents or, without texels, a target to draw into.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureObject {
    /// The name in logs and errors.
    pub name: String,
    /// The dimension.
    pub dimension: TextureDimension,
    /// Size of level 0: width, height, and number of layers or faces (6), or depth.
    pub size: [u32; 3],
    /// The format of a texel.
    pub format: TextureFormat,
    /// Number of mip levels, each half the size of the one before.
    pub levels: u32,
    /// Texels by level, with all layers of a level together; empty for a target. If there are texels of the first level
    /// alone and more levels, the adapter computes the others, each texel as the mean of four. Volumes need all levels.
    pub texels: Vec<Vec<u8>>,
    /// The contents change over time, as those of an [`ImageSequence`](crate::pager::ImageSequence). Such a texture is never
    /// replaced by another one of equal contents.
    pub is_changing: bool,
}

impl TextureObject {
    /// Creates an sRGB image of one level from RGBA bytes.
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

    /// Creates an sRGB image from RGBA bytes, whose mip levels the adapter computes.
    pub fn image_with_mips(name: &str, size: [u32; 2], rgba: Vec<u8>) -> Arc<Self> {
        let levels = (32 - size[0].max(size[1]).leading_zeros()).max(1);
        Arc::new(Self { levels, ..Arc::unwrap_or_clone(Self::image(name, size, rgba)) })
    }

    /// Creates a target for cameras to draw into.
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

    /// Returns true if the adapter computes the levels below the first.
    pub(crate) fn computes_levels(&self) -> bool {
        self.levels > 1 && self.texels.len() == 1 && self.dimension != TextureDimension::D3
    }

    /// Returns the size of a level.
    pub fn level_size(&self, level: u32) -> [u32; 3] {
        let [w, h, d] = self.size;
        let half = |side: u32| (side >> level.min(31)).max(1);
        let depth = if self.dimension == TextureDimension::D3 { half(d) } else { d };
        [half(w), if self.dimension == TextureDimension::D1 { 1 } else { half(h) }, depth]
    }

    /// Returns the bytes of all levels.
    pub(crate) fn size_bytes(&self) -> u64 {
        let texels = |level| self.level_size(level).into_iter().map(u64::from).fold(1, u64::saturating_mul);
        let bytes = |level| u64::saturating_mul(texels(level), self.format.texel_bytes() as u64);
        (0..self.levels.min(32)).map(bytes).fold(0, u64::saturating_add)
    }

    /// Returns true if the contents are uploaded once, with the page whose state sets have the texture.
    pub(crate) fn is_uploaded_once(&self) -> bool {
        !self.texels.is_empty() && !self.is_changing
    }

    /// Checks sizes and texels. Returns a description of the first inconsistency, or `None` if the texture is valid.
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
        let has_levels = self.texels.len() == self.levels as usize || self.computes_levels();
        if !has_levels || self.format.is_depth() {
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

/// The filter between texels.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum FilterMode {
    Nearest,
    #[default]
    Linear,
}

/// The texture address mode beyond the edges.
#[allow(missing_docs, reason = "OpenGL's names")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum WrapMode {
    #[default]
    ClampToEdge,
    Repeat,
    Mirror,
    /// Beyond the edges is [`Sampler::border_color`].
    ClampToBorder,
}

/// How a texture is sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampler {
    /// The filter where a texel covers less than a pixel.
    pub min_filter: FilterMode,
    /// The filter where a texel covers more than a pixel.
    pub mag_filter: FilterMode,
    /// The filter between mip levels.
    pub mip_filter: FilterMode,
    /// Address modes along s, t and r.
    pub wrap: [WrapMode; 3],
    /// Maximum number of samples along the steepest direction, 1 to 16; used where all filters are linear.
    pub max_anisotropy: u8,
    /// Bias that the fixed function adds to the mip level. wgpu samplers have none, so that programs must pass their own to
    /// `textureSampleBias`.
    pub mip_bias: f32,
    /// The colour of [`WrapMode::ClampToBorder`], as texels of the texture return it.
    ///
    /// Adapters with the wgpu feature `ADDRESS_MODE_CLAMP_TO_BORDER` have transparent black, opaque black and opaque white.
    /// For other colours, and on other adapters, the fixed function takes the colour itself: without a filter at the edge, and
    /// with the mip levels clamped to the edge. Programs see clamped edges then, which the renderer reports once.
    pub border_color: [f32; 4],
    /// Compares depth with a reference instead of returning it; for programs only.
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
            border_color: [0.0; 4],
            compare: None,
        }
    }
}

/// A texture with its sampler, for a unit of a state set.
#[derive(Clone, Debug)]
pub struct TextureBinding {
    /// The texture.
    pub texture: Arc<TextureObject>,
    /// The sampler.
    pub sampler: Sampler,
}

impl TextureBinding {
    /// Creates a binding with linear filters and clamped edges.
    pub fn new(texture: Arc<TextureObject>) -> Self {
        Self { texture, sampler: Sampler::default() }
    }
}

impl PartialEq for TextureBinding {
    /// Compares textures by identity.
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
        assert!(change(|t| t.levels = 2).is_none(), "the second level is computed");
        assert!(
            change(|t| (t.levels, t.texels) = (3, vec![vec![0; 32], vec![0; 8]])).is_some(),
            "one level is missing"
        );
        let volume = change(|t| (t.dimension, t.levels) = (TextureDimension::D3, 2));
        assert!(volume.is_some(), "levels of volumes are not computed");
        assert_eq!(TextureObject::image_with_mips("mips", [5, 300], vec![0; 6000]).levels, 9);
        assert!(change(|t| t.texels.clear()).is_none());
    }
}
