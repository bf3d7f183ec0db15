//! The array texture of the sun's shadow maps: one layer for each cascade. Draw thread.
//!
//! All views of a device's contexts share it, since the casters of a view are drawn right before the view. It is created
//! when a view first has shadows, as large as the largest view wants it; others use a part of it. It is freed or made
//! smaller when no view wanted as much for a while.

use crate::cull::{RenderStage, StageShadows};
use crate::gpu::Memory;
use crate::scene::MAX_CASCADES;

/// Draws that want a smaller texture, or none, after which it shrinks or is freed.
const KEPT_DRAWS: u32 = 120;

/// Array layers that every adapter supports.
const MAX_LAYERS: usize = 256;

pub(super) const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

struct Maps {
    all: wgpu::TextureView,
    layers: Vec<wgpu::TextureView>,
    size_px: u32,
}

/// The shadow maps of a renderer.
pub(super) struct ShadowMaps {
    sampler: wgpu::Sampler,
    /// A texture of one texel, bound where there are no shadows and while the maps are the render target.
    none: wgpu::TextureView,
    maps: Option<Maps>,
    /// The largest side that the adapter supports, in texels.
    max_px: u32,
    sizing: Sizing,
}

/// The size of the texture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct MapSize {
    /// Texels a side.
    size_px: u32,
    layers: usize,
}

impl MapSize {
    /// Grows to hold the shadows of a stage and of the views inside it, whose maps are all in use at once. Shadows with
    /// maps of more than `max_px` texels a side are left out.
    pub(super) fn add(&mut self, stage: &RenderStage, max_px: u32) {
        let all = std::iter::once(&stage.shadows).chain(stage.views.iter().map(|view| &view.shadows));
        let mut layers = 0;
        for shadows in all.filter(|s| !s.cascades.is_empty() && s.settings.resolution_px <= max_px) {
            layers = (layers + shadows.cascades.len().min(MAX_CASCADES)).min(MAX_LAYERS);
            *self = self.max(Self { size_px: shadows.settings.resolution_px, layers });
        }
    }

    /// Returns the memory of the texture in bytes.
    fn bytes(&self) -> u64 {
        4 * u64::from(self.size_px) * u64::from(self.size_px) * self.layers as u64
    }

    fn max(self, other: Self) -> Self {
        Self { size_px: self.size_px.max(other.size_px), layers: self.layers.max(other.layers) }
    }
}

/// The current size of the texture, and how long it has been larger than needed.
#[derive(Debug, Default)]
struct Sizing {
    current: MapSize,
    /// The number of successive draws that wanted less, and the largest size that one of them wanted.
    smaller_draws: u32,
    smaller: MapSize,
}

impl Sizing {
    /// Notes the size that a draw wants; returns true if the current size has changed. Contexts that take turns may want
    /// different sizes: the larger one stays.
    fn want(&mut self, wanted: MapSize) -> bool {
        let room = self.current.max(wanted);
        if wanted == self.current || room != self.current {
            (self.smaller_draws, self.smaller) = (0, MapSize::default());
            let grows = room != self.current;
            self.current = room;
            return grows;
        }
        self.smaller_draws += 1;
        self.smaller = self.smaller.max(wanted);
        if self.smaller_draws <= KEPT_DRAWS {
            return false;
        }
        self.smaller_draws = 0;
        let smaller = std::mem::take(&mut self.smaller);
        let shrinks = smaller != self.current;
        self.current = smaller;
        shrinks
    }
}

impl ShadowMaps {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self {
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("shadow maps"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                // Depths are reversed: a point is lit if it is at least as near to the sun as the nearest caster.
                compare: Some(wgpu::CompareFunction::GreaterEqual),
                ..Default::default()
            }),
            none: whole(&texture(device, 1, 1)),
            maps: None,
            max_px: device.limits().max_texture_dimension_2d,
            sizing: Sizing::default(),
        }
    }

    /// Returns the largest side that the adapter supports, in texels.
    pub(super) fn max_px(&self) -> u32 {
        self.max_px
    }

    /// Makes the texture large enough for the shadows of a draw's views. Returns true if it was replaced. Without
    /// memory for a larger one it stays as it is, and shadows that it has no room for are not drawn.
    pub(super) fn ensure(&mut self, memory: &Memory, wanted: MapSize) -> Result<bool, String> {
        let before = self.sizing.current;
        if !self.sizing.want(wanted) {
            return Ok(false);
        }
        let size = std::mem::replace(&mut self.sizing.current, before);
        let make = || memory.allocate("shadow maps", size.bytes(), |device| maps(device, size));
        self.maps = (size.size_px > 0).then(make).transpose()?;
        self.sizing.current = size;
        Ok(true)
    }

    /// Returns the view of one layer, the render target of a cascade.
    pub(super) fn layer(&self, layer: usize) -> Option<&wgpu::TextureView> {
        self.maps.as_ref()?.layers.get(layer)
    }

    /// Returns true if the maps have room for the cascades of some shadows from a layer on.
    pub(super) fn has_room(&self, shadows: &StageShadows, first_layer: usize) -> bool {
        let (count, size) = (shadows.cascades.len().min(MAX_CASCADES), self.sizing.current);
        count > 0 && size.size_px >= shadows.settings.resolution_px && size.layers >= first_layer + count
    }

    /// Returns the texels a side; 0 without maps.
    pub(super) fn size_px(&self) -> u32 {
        self.maps.as_ref().map_or(0, |m| m.size_px)
    }

    /// Returns the bindings 8 and 9 of group 0. `is_target` is true for passes that draw into the maps.
    pub(super) fn entries(&self, is_target: bool) -> [wgpu::BindGroupEntry<'_>; 2] {
        let view = self.maps.as_ref().filter(|_| !is_target).map_or(&self.none, |m| &m.all);
        [
            wgpu::BindGroupEntry { binding: 8, resource: wgpu::BindingResource::TextureView(view) },
            wgpu::BindGroupEntry { binding: 9, resource: wgpu::BindingResource::Sampler(&self.sampler) },
        ]
    }
}

fn maps(device: &wgpu::Device, wanted: MapSize) -> Maps {
    let layers = wanted.layers as u32;
    let texture = texture(device, wanted.size_px, layers);
    let layer = |base_array_layer| {
        texture.create_view(&wgpu::TextureViewDescriptor {
            label: Some("cascade"),
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_array_layer,
            array_layer_count: Some(1),
            ..Default::default()
        })
    };
    Maps { all: whole(&texture), layers: (0..layers).map(layer).collect(), size_px: wanted.size_px }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn size(size_px: u32, layers: usize) -> MapSize {
        MapSize { size_px, layers }
    }

    #[test]
    fn alternating_sizes_keep_the_larger_texture() {
        let mut sizing = Sizing::default();
        assert!(!sizing.want(size(0, 0)));
        assert!(sizing.want(size(512, 2)) && sizing.current == size(512, 2));
        assert!(sizing.want(size(2048, 1)) && sizing.current == size(2048, 2), "large enough for both");
        for _ in 0..3 * KEPT_DRAWS {
            assert!(!sizing.want(size(512, 2)) && !sizing.want(size(0, 0)) && !sizing.want(size(2048, 1)));
        }
    }

    #[test]
    fn unneeded_size_is_given_up_after_some_draws() {
        let mut sizing = Sizing::default();
        assert!(sizing.want(size(2048, 4)));
        for draw in 0..KEPT_DRAWS {
            let smaller = if draw % 2 == 0 { size(512, 4) } else { size(256, 1) };
            assert!(!sizing.want(smaller));
        }
        assert!(sizing.want(size(256, 1)) && sizing.current == size(512, 4), "the largest size of the last draws");
        for _ in 0..KEPT_DRAWS {
            assert!(!sizing.want(size(0, 0)));
        }
        assert!(sizing.want(size(0, 0)) && sizing.current == size(0, 0));
        assert!(sizing.want(size(64, 1)));
    }
}
