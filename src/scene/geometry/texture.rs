//! [`Texture`]: the image of a material as plain CPU data, the format of its texels and how it is sampled.

use crate::state::{FilterMode, WrapMode};

/// The format of the texels in memory. Compressed formats have blocks of 4 x 4 texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TexelFormat {
    /// Four bytes a texel.
    #[default]
    Rgba8,
    /// BC1 without transparent texels: 8 bytes a block.
    Bc1,
    /// BC3: 16 bytes a block.
    Bc3,
    /// BC7: 16 bytes a block.
    Bc7,
    /// ETC2 without alpha: 8 bytes a block.
    Etc2Rgb,
    /// ETC2 with EAC alpha: 16 bytes a block.
    Etc2Rgba,
    /// ASTC with blocks of 4 x 4 texels: 16 bytes a block.
    Astc4x4,
}

impl TexelFormat {
    /// Returns true if the texels are compressed in blocks.
    pub const fn is_compressed(self) -> bool {
        !matches!(self, Self::Rgba8)
    }

    /// Returns the side of a block in texels; 1 for formats without blocks.
    pub const fn block_side(self) -> u32 {
        if self.is_compressed() { 4 } else { 1 }
    }

    /// Returns the size of a block, or of a texel, in bytes.
    pub const fn block_bytes(self) -> u32 {
        match self {
            Self::Rgba8 => 4,
            Self::Bc1 | Self::Etc2Rgb => 8,
            Self::Bc3 | Self::Bc7 | Self::Etc2Rgba | Self::Astc4x4 => 16,
        }
    }

    /// Returns the number of rows of blocks, or of texels, of a height in texels.
    pub const fn rows(self, height: u32) -> u32 {
        height.div_ceil(self.block_side())
    }

    /// Returns the size of a row of blocks, or of texels, in bytes, for a width in texels.
    pub const fn row_bytes(self, width: u32) -> u64 {
        width.div_ceil(self.block_side()) as u64 * self.block_bytes() as u64
    }

    /// Returns the size of an image in bytes, for a width and height in texels.
    pub const fn image_bytes(self, width: u32, height: u32) -> u64 {
        self.row_bytes(width).saturating_mul(self.rows(height) as u64)
    }
}

/// A set of families of compressed formats: those that an adapter samples, or that a texture needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockFormats {
    /// BC1, BC3 and BC7.
    pub bc: bool,
    /// ETC2.
    pub etc2: bool,
    /// ASTC.
    pub astc: bool,
}

impl BlockFormats {
    /// No family: images are held as RGBA8.
    pub const NONE: Self = Self { bc: false, etc2: false, astc: false };

    /// Returns the family that a format needs; [`Self::NONE`] for RGBA8.
    pub const fn of(format: TexelFormat) -> Self {
        match format {
            TexelFormat::Rgba8 => Self::NONE,
            TexelFormat::Bc1 | TexelFormat::Bc3 | TexelFormat::Bc7 => Self { bc: true, ..Self::NONE },
            TexelFormat::Etc2Rgb | TexelFormat::Etc2Rgba => Self { etc2: true, ..Self::NONE },
            TexelFormat::Astc4x4 => Self { astc: true, ..Self::NONE },
        }
    }

    /// Returns the families of both sets.
    pub const fn intersection(self, other: Self) -> Self {
        Self { bc: self.bc && other.bc, etc2: self.etc2 && other.etc2, astc: self.astc && other.astc }
    }

    /// Returns the families of either set.
    pub const fn union(self, other: Self) -> Self {
        Self { bc: self.bc || other.bc, etc2: self.etc2 || other.etc2, astc: self.astc || other.astc }
    }

    /// Returns true if all families of the other set are in this one.
    pub fn contains(self, other: Self) -> bool {
        self.intersection(other) == other
    }
}

/// How a texture is sampled: a glTF sampler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Sampling {
    /// How texture coordinates outside 0..1 wrap, along u and along v.
    pub wrap: [WrapMode; 2],
    /// The filter where a texel covers more than a pixel.
    pub mag: FilterMode,
    /// The filter where a texel covers less than a pixel.
    pub min: FilterMode,
    /// The filter between mip levels; `None` if level 0 alone is sampled.
    pub mip: Option<FilterMode>,
}

impl Default for Sampling {
    /// Clamps to the edges and filters linearly within and between levels.
    fn default() -> Self {
        let linear = FilterMode::Linear;
        Self { wrap: [WrapMode::ClampToEdge; 2], mag: linear, min: linear, mip: Some(linear) }
    }
}

impl Sampling {
    /// Returns bytes that differ for different values, for keys of equal contents.
    pub(crate) fn key(self) -> [u8; 5] {
        let Self { wrap: [u, v], mag, min, mip } = self;
        [u as u8, v as u8, mag as u8, min as u8, mip.map_or(u8::MAX, |mip| mip as u8)]
    }
}

/// An image with its mip levels, level 0 first, each half the size of the one before (at least 1).
#[derive(Clone, PartialEq)]
pub struct Texture {
    /// Width of level 0 in texels. A multiple of 4 in compressed formats.
    pub width: u32,
    /// Height of level 0 in texels. A multiple of 4 in compressed formats.
    pub height: u32,
    /// The format of the texels.
    pub format: TexelFormat,
    /// Rows of texels or of blocks, top to bottom, without gaps; one entry per level. Colours are sRGB; the maps of a
    /// [`MetallicRoughness`](super::MetallicRoughness) are linear where it says so.
    pub mips: Vec<Vec<u8>>,
    /// How it is sampled.
    pub sampling: Sampling,
}

impl Texture {
    /// Creates a texture of RGBA8 texels with the default sampling.
    pub fn rgba8(width: u32, height: u32, mips: Vec<Vec<u8>>) -> Self {
        Self { width, height, format: TexelFormat::Rgba8, mips, sampling: Sampling::default() }
    }

    /// Returns the size of all levels in bytes.
    pub fn size_bytes(&self) -> u64 {
        self.mips.iter().map(|mip| mip.len() as u64).sum()
    }
}

impl std::fmt::Debug for Texture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Texture({}x{} {:?}, {} mips)", self.width, self.height, self.format, self.mips.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partial_blocks_count_as_whole_ones() {
        assert_eq!(TexelFormat::Rgba8.image_bytes(7, 5), 140);
        assert_eq!(TexelFormat::Bc1.image_bytes(8, 4), 16);
        assert_eq!(TexelFormat::Bc7.image_bytes(7, 5), 64);
        assert_eq!(TexelFormat::Astc4x4.image_bytes(1, 1), 16);
        assert_eq!((TexelFormat::Etc2Rgb.rows(9), TexelFormat::Etc2Rgb.row_bytes(9)), (3, 24));
    }

    #[test]
    fn families_are_sets() {
        let bc = BlockFormats::of(TexelFormat::Bc7);
        let astc = BlockFormats::of(TexelFormat::Astc4x4);
        assert!(bc.union(astc).contains(astc) && !bc.contains(astc));
        assert_eq!(bc.intersection(astc), BlockFormats::of(TexelFormat::Rgba8));
        assert!(BlockFormats::NONE.contains(BlockFormats::NONE));
    }
}
