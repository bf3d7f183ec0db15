//! [`ImageSize`]: the size and format of a mesh texture with its mip levels, and the creation of array textures for it.

use super::texture_rows::TextureRows;
use crate::gpu::memory::Memory;
use crate::gpu::pools::wgpu_enums::{TexelEncoding, texel_format};
use crate::scene::{BlockFormats, TexelFormat, Texture};

/// The size and format of an image with its mip levels. Images of one size and format share blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::gpu::pools) struct ImageSize {
    width: u32,
    height: u32,
    mips: u32,
    format: TexelFormat,
}

impl ImageSize {
    /// The size of the white texel of drawables without a texture.
    pub(in crate::gpu::pools) const ONE_TEXEL: Self = Self { width: 1, height: 1, mips: 1, format: TexelFormat::Rgba8 };

    /// Returns the size of a texture, after a check that the adapter has its format and that each level has the bytes that
    /// the size demands.
    pub(in crate::gpu::pools) fn of(
        texture: &Texture,
        limits: &wgpu::Limits,
        adapter: BlockFormats,
    ) -> Result<Self, String> {
        let Texture { width, height, format, .. } = *texture;
        if !adapter.contains(BlockFormats::of(format)) {
            return Err(format!("a texture in {format:?}, which the adapter cannot sample"));
        }
        let limit = limits.max_texture_dimension_2d;
        if width == 0 || height == 0 || width > limit || height > limit {
            return Err(format!("a texture of {width}x{height} texels is not possible (1 to {limit} a side)"));
        }
        if !width.is_multiple_of(format.block_side()) || !height.is_multiple_of(format.block_side()) {
            return Err(format!("a texture of {width}x{height} texels in {format:?}, whose blocks have 4x4"));
        }
        let max_mips = 32 - width.max(height).leading_zeros();
        let mips = texture.mips.len();
        if mips == 0 || mips > max_mips as usize {
            return Err(format!("a texture of {width}x{height} texels has {mips} levels (1 to {max_mips})"));
        }
        let size = Self { width, height, mips: mips as u32, format };
        for (level, data) in (0u32..).zip(&texture.mips) {
            let [w, h] = size.level(level);
            let (got, expected) = (data.len() as u64, format.image_bytes(w, h));
            if got != expected {
                return Err(format!("level {level} of a texture has {got} bytes instead of {expected}"));
            }
        }
        Ok(size)
    }

    /// Returns width and height of a level in texels.
    fn level(&self, level: u32) -> [u32; 2] {
        [(self.width >> level).max(1), (self.height >> level).max(1)]
    }

    /// Returns the size of all levels in bytes.
    pub(in crate::gpu::pools) fn bytes(&self) -> u64 {
        let of_level = |[width, height]: [u32; 2]| self.format.image_bytes(width, height);
        (0..self.mips).map(|level| of_level(self.level(level))).sum()
    }

    /// Returns true if a texture has this size and format.
    pub(super) fn is_size_of(&self, texture: &wgpu::Texture, encoding: TexelEncoding) -> bool {
        [texture.width(), texture.height(), texture.mip_level_count()] == [self.width, self.height, self.mips]
            && texture.format() == texel_format(self.format, encoding)
    }

    /// Returns all rows of a level in the first layer.
    pub(super) fn rows_of(&self, level: u32) -> TextureRows {
        let [width, height] = self.level(level);
        let (row_bytes, block_side) = (self.format.row_bytes(width) as u32, self.format.block_side());
        TextureRows { layer: 0, level, first: 0, count: self.format.rows(height), width, row_bytes, block_side }
    }

    /// Does the same as [`Self::create`], and returns an error text if the adapter lacks the memory.
    pub(in crate::gpu::pools) fn allocate(
        &self,
        memory: &Memory,
        label: &'static str,
        layers: u32,
        encoding: TexelEncoding,
    ) -> Result<wgpu::Texture, String> {
        memory.allocate(label, self.bytes() * u64::from(layers), |device| self.create(device, label, layers, encoding))
    }

    /// Creates an array texture.
    pub(super) fn create(
        &self,
        device: &wgpu::Device,
        label: &str,
        layers: u32,
        encoding: TexelEncoding,
    ) -> wgpu::Texture {
        device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d { width: self.width, height: self.height, depth_or_array_layers: layers },
            mip_level_count: self.mips,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: texel_format(self.format, encoding),
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        })
    }
}

/// Creates the view of all layers of an array texture.
pub(in crate::gpu::pools) fn array_view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}
