//! [`ImageSize`]: the size of a mesh texture with its mip levels, and the creation of array textures of that size.

use crate::gpu::memory::Memory;
use crate::scene::Texture;

/// The meaning of an image's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::gpu) enum TexelEncoding {
    /// Colours in sRGB, with linear alpha.
    Srgb,
    /// Numbers from 0 to 1.
    Linear,
}

impl TexelEncoding {
    fn format(self) -> wgpu::TextureFormat {
        match self {
            Self::Srgb => wgpu::TextureFormat::Rgba8UnormSrgb,
            Self::Linear => wgpu::TextureFormat::Rgba8Unorm,
        }
    }
}

/// The size of an image with its mip levels. Images of one size share blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::gpu::pools) struct ImageSize {
    width: u32,
    height: u32,
    mips: u32,
}

impl ImageSize {
    /// The size of the white texel of drawables without a texture.
    pub(in crate::gpu::pools) const ONE_TEXEL: Self = Self { width: 1, height: 1, mips: 1 };

    /// Returns the size of a texture, after a check that each level has the bytes that the size demands.
    pub(in crate::gpu::pools) fn of(texture: &Texture, limits: &wgpu::Limits) -> Result<Self, String> {
        let (width, height) = (texture.width, texture.height);
        let limit = limits.max_texture_dimension_2d;
        if width == 0 || height == 0 || width > limit || height > limit {
            return Err(format!("a texture of {width}x{height} texels is not possible (1 to {limit} a side)"));
        }
        let max_mips = 32 - width.max(height).leading_zeros();
        let mips = texture.mips.len();
        if mips == 0 || mips > max_mips as usize {
            return Err(format!("a texture of {width}x{height} texels has {mips} levels (1 to {max_mips})"));
        }
        let size = Self { width, height, mips: mips as u32 };
        for (level, data) in (0u32..).zip(&texture.mips) {
            let [w, h] = size.level(level);
            let expected = w as usize * h as usize * 4;
            if data.len() != expected {
                return Err(format!("level {level} of a texture has {} bytes instead of {expected}", data.len()));
            }
        }
        Ok(size)
    }

    /// Returns width and height of a level in texels.
    pub(super) fn level(&self, level: u32) -> [u32; 2] {
        [(self.width >> level).max(1), (self.height >> level).max(1)]
    }

    /// Returns the size of all levels in bytes.
    pub(in crate::gpu::pools) fn bytes(&self) -> u64 {
        (0..self.mips).map(|l| self.level(l).map(u64::from).iter().product::<u64>() * 4).sum()
    }

    /// Returns true if a texture has this size.
    pub(super) fn is_size_of(&self, texture: &wgpu::Texture) -> bool {
        [texture.width(), texture.height(), texture.mip_level_count()] == [self.width, self.height, self.mips]
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
            format: encoding.format(),
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
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
