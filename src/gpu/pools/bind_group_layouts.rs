//! [`BindGroupLayouts`]: the layouts of bind group 0 (frame) and bind group 1 (blocks of the pools) of all pipelines, and
//! the creation of the samplers of blocks. Created with the device; read on the draw thread.

use super::wgpu_enums::{address_mode, filter_mode, mipmap_filter_mode};
use crate::scene::{MetallicRoughness, Sampling};
use crate::state::FilterMode;

/// The layouts of a device, shared by all blocks and pipelines.
pub(crate) struct BindGroupLayouts {
    /// Group 0: uniforms of the frame, leaves, tables of the air, shadow maps.
    pub(crate) frame: wgpu::BindGroupLayout,
    /// Group 1 of height tiles: heights, tables, colour, sampler.
    pub(crate) height_block: wgpu::BindGroupLayout,
    /// Group 1 of meshes: colour, sampler.
    pub(crate) texture_block: wgpu::BindGroupLayout,
    /// Group 1 of meshes with a metallic-roughness surface: colour, normals, occlusion-roughness-metallic, emission and
    /// occlusion, each with its sampler; the records of surfaces.
    pub(crate) surface_set: wgpu::BindGroupLayout,
    /// The same for layered surfaces, which also have maps of dielectric and coat.
    pub(crate) layered_set: wgpu::BindGroupLayout,
    /// Group 1 of Gaussian splats: the splats, the order in which they are drawn, and their harmonics.
    pub(crate) splats: wgpu::BindGroupLayout,
    max_anisotropy: u16,
}

fn array_texture(binding: u32, visibility: wgpu::ShaderStages, filterable: bool) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty: wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable },
            view_dimension: wgpu::TextureViewDimension::D2Array,
            multisampled: false,
        },
        count: None,
    }
}

fn sampler(binding: u32) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT,
        ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
        count: None,
    }
}

/// Creates the layout of group 0, which everything drawn has: uniforms of the frame and of the leaves, the tables of the
/// air and the shadow maps.
fn frame_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let uniform = wgpu::BufferBindingType::Uniform;
    let buffer = |binding, visibility, ty, has_dynamic_offset| wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None },
        count: None,
    };
    let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
    let air_texture = |binding, view_dimension| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: both,
        ty: wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension,
            multisampled: false,
        },
        count: None,
    };
    let air_sampler = wgpu::BindGroupLayoutEntry {
        binding: 3,
        visibility: both,
        ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
        count: None,
    };
    let shadow_maps = wgpu::BindGroupLayoutEntry {
        binding: 8,
        visibility: both,
        ty: wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Depth,
            view_dimension: wgpu::TextureViewDimension::D2Array,
            multisampled: false,
        },
        count: None,
    };
    let shadow_sampler = wgpu::BindGroupLayoutEntry {
        binding: 9,
        visibility: both,
        ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Comparison),
        count: None,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("frame"),
        entries: &[
            buffer(0, both, uniform, true),
            buffer(1, both, wgpu::BufferBindingType::Storage { read_only: true }, false),
            buffer(2, both, uniform, true),
            air_sampler,
            air_texture(4, wgpu::TextureViewDimension::D2),
            air_texture(5, wgpu::TextureViewDimension::D2),
            air_texture(6, wgpu::TextureViewDimension::D3),
            air_texture(7, wgpu::TextureViewDimension::D3),
            shadow_maps,
            shadow_sampler,
        ],
    })
}

impl BindGroupLayouts {
    pub(in crate::gpu) fn new(device: &wgpu::Device, max_anisotropy: u16) -> Self {
        let tables = wgpu::BindGroupLayoutEntry {
            binding: 1,
            visibility: wgpu::ShaderStages::VERTEX,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only: true },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        let height_block = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("height block"),
            entries: &[
                array_texture(0, wgpu::ShaderStages::VERTEX, false),
                tables,
                array_texture(2, wgpu::ShaderStages::FRAGMENT, true),
                sampler(3),
            ],
        });
        let texture_block = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("texture block"),
            entries: &[array_texture(0, wgpu::ShaderStages::FRAGMENT, true), sampler(1)],
        });
        let surface_layout = |label, maps: u32| {
            let textures = (0..=maps)
                .flat_map(|map| [array_texture(2 * map, wgpu::ShaderStages::FRAGMENT, true), sampler(2 * map + 1)]);
            let binding = 2 * (maps + 1);
            let records = wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::FRAGMENT, ..tables };
            let entries = textures.chain([records]).collect::<Vec<_>>();
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
        };
        let splats = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("splats"),
            entries: &[0, 1, 2].map(|binding| wgpu::BindGroupLayoutEntry { binding, ..tables }),
        });
        Self {
            frame: frame_layout(device),
            height_block,
            texture_block,
            surface_set: surface_layout("surface set", MetallicRoughness::PLAIN_MAPS as u32),
            layered_set: surface_layout("set of layered surfaces", MetallicRoughness::MAPS as u32),
            splats,
            max_anisotropy,
        }
    }

    /// Creates the sampler of a block.
    pub(super) fn sampler(&self, device: &wgpu::Device, sampling: &Sampling) -> wgpu::Sampler {
        let Sampling { wrap: [u, v], mag, min, mip } = *sampling;
        // Without levels, the filter between them has no effect but on anisotropy.
        let all_linear = [mag, min, mip.unwrap_or_default()] == [FilterMode::Linear; 3];
        device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("texture block"),
            address_mode_u: address_mode(u),
            address_mode_v: address_mode(v),
            mag_filter: filter_mode(mag),
            min_filter: filter_mode(min),
            mipmap_filter: mipmap_filter_mode(mip.unwrap_or_default()),
            lod_max_clamp: if mip.is_some() { 32.0 } else { 0.0 },
            // WebGPU allows anisotropy with linear filters only.
            anisotropy_clamp: if all_linear { self.max_anisotropy } else { 1 },
            ..Default::default()
        })
    }
}
