//! wgpu's counterparts of the enums of state sets. Plain values.

use crate::scene::TexelFormat;
use crate::state::{CompareFunction, FilterMode, TextureDimension, TextureFormat, WrapMode};

/// The meaning of an image's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::gpu) enum TexelEncoding {
    /// Colours in sRGB, with linear alpha.
    Srgb,
    /// Numbers from 0 to 1.
    Linear,
}

pub(crate) fn texture_format(format: TextureFormat) -> wgpu::TextureFormat {
    match format {
        TextureFormat::Rgba8Srgb => wgpu::TextureFormat::Rgba8UnormSrgb,
        TextureFormat::Rgba8 => wgpu::TextureFormat::Rgba8Unorm,
        TextureFormat::Rgba16Float => wgpu::TextureFormat::Rgba16Float,
        TextureFormat::R8 => wgpu::TextureFormat::R8Unorm,
        TextureFormat::R32Float => wgpu::TextureFormat::R32Float,
        TextureFormat::Depth32 => wgpu::TextureFormat::Depth32Float,
        TextureFormat::Depth24Stencil8 => wgpu::TextureFormat::Depth24PlusStencil8,
        TextureFormat::Depth32Stencil8 => wgpu::TextureFormat::Depth32FloatStencil8,
    }
}

/// Returns the format of a mesh texture.
pub(in crate::gpu::pools) fn texel_format(format: TexelFormat, encoding: TexelEncoding) -> wgpu::TextureFormat {
    let (srgb, linear) = match format {
        TexelFormat::Rgba8 => (wgpu::TextureFormat::Rgba8UnormSrgb, wgpu::TextureFormat::Rgba8Unorm),
        TexelFormat::Bc1 => (wgpu::TextureFormat::Bc1RgbaUnormSrgb, wgpu::TextureFormat::Bc1RgbaUnorm),
        TexelFormat::Bc3 => (wgpu::TextureFormat::Bc3RgbaUnormSrgb, wgpu::TextureFormat::Bc3RgbaUnorm),
        TexelFormat::Bc7 => (wgpu::TextureFormat::Bc7RgbaUnormSrgb, wgpu::TextureFormat::Bc7RgbaUnorm),
        TexelFormat::Etc2Rgb => (wgpu::TextureFormat::Etc2Rgb8UnormSrgb, wgpu::TextureFormat::Etc2Rgb8Unorm),
        TexelFormat::Etc2Rgba => (wgpu::TextureFormat::Etc2Rgba8UnormSrgb, wgpu::TextureFormat::Etc2Rgba8Unorm),
        TexelFormat::Astc4x4 => {
            let astc = |channel| wgpu::TextureFormat::Astc { block: wgpu::AstcBlock::B4x4, channel };
            (astc(wgpu::AstcChannel::UnormSrgb), astc(wgpu::AstcChannel::Unorm))
        }
    };
    match encoding {
        TexelEncoding::Srgb => srgb,
        TexelEncoding::Linear => linear,
    }
}

pub(crate) fn view_dimension(dimension: TextureDimension) -> wgpu::TextureViewDimension {
    match dimension {
        // One-dimensional textures have no mips in wgpu. A plane of one row samples alike.
        TextureDimension::D1 | TextureDimension::D2 => wgpu::TextureViewDimension::D2,
        TextureDimension::D2Array => wgpu::TextureViewDimension::D2Array,
        TextureDimension::Cube => wgpu::TextureViewDimension::Cube,
        TextureDimension::D3 => wgpu::TextureViewDimension::D3,
    }
}

pub(in crate::gpu::pools) fn filter_mode(mode: FilterMode) -> wgpu::FilterMode {
    match mode {
        FilterMode::Nearest => wgpu::FilterMode::Nearest,
        FilterMode::Linear => wgpu::FilterMode::Linear,
    }
}

pub(in crate::gpu::pools) fn mipmap_filter_mode(mode: FilterMode) -> wgpu::MipmapFilterMode {
    match mode {
        FilterMode::Nearest => wgpu::MipmapFilterMode::Nearest,
        FilterMode::Linear => wgpu::MipmapFilterMode::Linear,
    }
}

pub(in crate::gpu::pools) fn address_mode(mode: WrapMode) -> wgpu::AddressMode {
    match mode {
        WrapMode::ClampToEdge => wgpu::AddressMode::ClampToEdge,
        WrapMode::Repeat => wgpu::AddressMode::Repeat,
        WrapMode::Mirror => wgpu::AddressMode::MirrorRepeat,
        WrapMode::ClampToBorder => wgpu::AddressMode::ClampToBorder,
    }
}

/// Returns wgpu's border with a colour; `None` for a colour that it does not have.
pub(in crate::gpu::pools) fn border_color(color: [f32; 4]) -> Option<wgpu::SamplerBorderColor> {
    if color == [0.0; 4] {
        Some(wgpu::SamplerBorderColor::TransparentBlack)
    } else if color == [0.0, 0.0, 0.0, 1.0] {
        Some(wgpu::SamplerBorderColor::OpaqueBlack)
    } else if color == [1.0; 4] {
        Some(wgpu::SamplerBorderColor::OpaqueWhite)
    } else {
        None
    }
}

/// Returns the comparison of plain values. Depths are stored reversed and need the opposite one.
pub(crate) fn compare_function(function: CompareFunction) -> wgpu::CompareFunction {
    match function {
        CompareFunction::Never => wgpu::CompareFunction::Never,
        CompareFunction::Less => wgpu::CompareFunction::Less,
        CompareFunction::Equal => wgpu::CompareFunction::Equal,
        CompareFunction::LessOrEqual => wgpu::CompareFunction::LessEqual,
        CompareFunction::Greater => wgpu::CompareFunction::Greater,
        CompareFunction::NotEqual => wgpu::CompareFunction::NotEqual,
        CompareFunction::GreaterOrEqual => wgpu::CompareFunction::GreaterEqual,
        CompareFunction::Always => wgpu::CompareFunction::Always,
    }
}
