//! The texture that shadows of the sun are drawn into and read from: a layer for each cascade. Draw thread.
//!
//! All pictures of a frame share it, one after the other: a picture's casters are drawn right before it. Made when a
//! picture first has shadows, and given back when none had them for a while.

use crate::cull::{MOST_CASCADES, StageShadows};

/// Frames without shadows after which the texture is given back.
const KEPT_FRAMES: u32 = 120;

pub(super) const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

struct Maps {
    all: wgpu::TextureView,
    layers: Vec<wgpu::TextureView>,
    size_px: u32,
}

/// Shadow maps of a renderer.
pub(super) struct ShadowMaps {
    sampler: wgpu::Sampler,
    /// One texel, bound where there are no shadows, and while they are drawn.
    none: wgpu::TextureView,
    maps: Option<Maps>,
    /// Texels a side that the adapter has at most.
    pub(super) most_px: u32,
    unused_frames: u32,
}

impl ShadowMaps {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self {
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("shadow maps"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                // Reversed-Z: lit is what is at least as near to the sun as what is nearest.
                compare: Some(wgpu::CompareFunction::GreaterEqual),
                ..Default::default()
            }),
            none: whole(&texture(device, 1, 1)),
            maps: None,
            most_px: device.limits().max_texture_dimension_2d,
            unused_frames: 0,
        }
    }

    /// Makes room for the shadows of a frame's pictures, if any; true when the texture is another one than before.
    pub(super) fn ensure<'a>(
        &mut self,
        device: &wgpu::Device,
        wanted: impl Iterator<Item = &'a StageShadows> + Clone,
    ) -> bool {
        let wanted = wanted.filter(|s| !s.cascades.is_empty());
        let size_px = wanted.clone().map(|s| s.settings.resolution_px).max().unwrap_or(0);
        let layers = wanted.map(|s| s.cascades.len()).max().unwrap_or(0).min(MOST_CASCADES);
        if size_px == 0 {
            self.unused_frames = self.unused_frames.saturating_add(1);
            return self.unused_frames > KEPT_FRAMES && self.maps.take().is_some();
        }
        self.unused_frames = 0;
        if self.maps.as_ref().is_some_and(|m| m.size_px == size_px && m.layers.len() >= layers) {
            return false;
        }
        let texture = texture(device, size_px, layers as u32);
        let layer = |base_array_layer| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                label: Some("cascade"),
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer,
                array_layer_count: Some(1),
                ..Default::default()
            })
        };
        self.maps = Some(Maps { all: whole(&texture), layers: (0..layers as u32).map(layer).collect(), size_px });
        true
    }

    /// What a cascade is drawn into.
    pub(super) fn layer(&self, cascade: usize) -> Option<&wgpu::TextureView> {
        self.maps.as_ref()?.layers.get(cascade)
    }

    /// Texels a side; 0 without maps.
    pub(super) fn size_px(&self) -> u32 {
        self.maps.as_ref().map_or(0, |m| m.size_px)
    }

    /// What shaders read, from binding 8 of group 0 on; `is_drawn` while the maps themselves are drawn into.
    pub(super) fn entries(&self, is_drawn: bool) -> [wgpu::BindGroupEntry<'_>; 2] {
        let view = self.maps.as_ref().filter(|_| !is_drawn).map_or(&self.none, |m| &m.all);
        [
            wgpu::BindGroupEntry { binding: 8, resource: wgpu::BindingResource::TextureView(view) },
            wgpu::BindGroupEntry { binding: 9, resource: wgpu::BindingResource::Sampler(&self.sampler) },
        ]
    }
}

fn texture(device: &wgpu::Device, size_px: u32, layers: u32) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some("shadow maps"),
        size: wgpu::Extent3d { width: size_px, height: size_px, depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    })
}

fn whole(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        label: Some("shadow maps"),
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}
