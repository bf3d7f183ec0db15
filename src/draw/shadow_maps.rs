//! The texture that shadows of the sun are drawn into and read from: a layer for each cascade. Draw thread.
//!
//! All pictures of a device's contexts share it, one after the other: a picture's casters are drawn right before it. Made
//! when a picture first has shadows, as large as the largest wants it; smaller ones use a part. Given back when none had
//! shadows for a while, and made smaller when none wanted that much.

use crate::cull::{MAX_CASCADES, RenderStage, StageShadows};
use crate::gpu::Memory;

/// Draws without shadows after which the texture is given back, and with less of them after which it shrinks.
const KEPT_DRAWS: u32 = 120;

/// Layers that every adapter has.
const MOST_LAYERS: usize = 256;

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
    sizing: Sizing,
}

/// Texels a side and layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Wanted {
    size_px: u32,
    layers: usize,
}

impl Wanted {
    /// With room for the shadows of a stage and of the views inside it, which are drawn at once; if the adapter has maps
    /// that large.
    pub(super) fn add(&mut self, stage: &RenderStage, most_px: u32) {
        let all = std::iter::once(&stage.shadows).chain(stage.views.iter().map(|view| &view.shadows));
        let mut layers = 0;
        for shadows in all.filter(|s| !s.cascades.is_empty() && s.settings.resolution_px <= most_px) {
            layers = (layers + shadows.cascades.len().min(MAX_CASCADES)).min(MOST_LAYERS);
            *self = self.max(Self { size_px: shadows.settings.resolution_px, layers });
        }
    }

    fn bytes(&self) -> u64 {
        4 * u64::from(self.size_px) * u64::from(self.size_px) * self.layers as u64
    }

    fn max(self, other: Self) -> Self {
        Self { size_px: self.size_px.max(other.size_px), layers: self.layers.max(other.layers) }
    }
}

/// How large the texture is, and for how long it has been too large.
#[derive(Debug, Default)]
struct Sizing {
    has: Wanted,
    /// Draws in a row that wanted less, and the most that one of them wanted.
    lesser_draws: u32,
    lesser: Wanted,
}

impl Sizing {
    /// True when what there is has changed. Contexts that take turns may want different maps: the larger ones stay.
    fn want(&mut self, wanted: Wanted) -> bool {
        let room = self.has.max(wanted);
        if wanted == self.has || room != self.has {
            (self.lesser_draws, self.lesser) = (0, Wanted::default());
            let grows = room != self.has;
            self.has = room;
            return grows;
        }
        self.lesser_draws += 1;
        self.lesser = self.lesser.max(wanted);
        if self.lesser_draws <= KEPT_DRAWS {
            return false;
        }
        self.lesser_draws = 0;
        let lesser = std::mem::take(&mut self.lesser);
        let shrinks = lesser != self.has;
        self.has = lesser;
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
                // Reversed-Z: lit is what is at least as near to the sun as what is nearest.
                compare: Some(wgpu::CompareFunction::GreaterEqual),
                ..Default::default()
            }),
            none: whole(&texture(device, 1, 1)),
            maps: None,
            most_px: device.limits().max_texture_dimension_2d,
            sizing: Sizing::default(),
        }
    }

    /// Makes room for the shadows of a draw's pictures, if any; true when the texture is another one than before. Where
    /// there is no memory for it, it stays as it is, and what it has no room for throws no shadows.
    pub(super) fn ensure(&mut self, memory: &Memory, wanted: Wanted) -> Result<bool, String> {
        let had = self.sizing.has;
        if !self.sizing.want(wanted) {
            return Ok(false);
        }
        let has = std::mem::replace(&mut self.sizing.has, had);
        let make = || memory.make("shadow maps", has.bytes(), |device| maps(device, has));
        self.maps = (has.size_px > 0).then(make).transpose()?;
        self.sizing.has = has;
        Ok(true)
    }

    /// What a cascade is drawn into.
    pub(super) fn layer(&self, layer: usize) -> Option<&wgpu::TextureView> {
        self.maps.as_ref()?.layers.get(layer)
    }

    /// True when there are maps for the cascades of a picture, from a layer on.
    pub(super) fn has_room(&self, shadows: &StageShadows, first_layer: usize) -> bool {
        let (count, has) = (shadows.cascades.len().min(MAX_CASCADES), self.sizing.has);
        count > 0 && has.size_px >= shadows.settings.resolution_px && has.layers >= first_layer + count
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

fn maps(device: &wgpu::Device, wanted: Wanted) -> Maps {
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

    fn of(size_px: u32, layers: usize) -> Wanted {
        Wanted { size_px, layers }
    }

    #[test]
    fn contexts_that_take_turns_change_nothing() {
        let mut sizing = Sizing::default();
        assert!(!sizing.want(of(0, 0)));
        assert!(sizing.want(of(512, 2)) && sizing.has == of(512, 2));
        assert!(sizing.want(of(2048, 1)) && sizing.has == of(2048, 2), "what both of them need");
        for _ in 0..3 * KEPT_DRAWS {
            assert!(!sizing.want(of(512, 2)) && !sizing.want(of(0, 0)) && !sizing.want(of(2048, 1)));
        }
    }

    #[test]
    fn what_is_too_large_goes_in_the_end() {
        let mut sizing = Sizing::default();
        assert!(sizing.want(of(2048, 4)));
        for draw in 0..KEPT_DRAWS {
            let smaller = if draw % 2 == 0 { of(512, 4) } else { of(256, 1) };
            assert!(!sizing.want(smaller));
        }
        assert!(sizing.want(of(256, 1)) && sizing.has == of(512, 4), "what the last draws wanted");
        for _ in 0..KEPT_DRAWS {
            assert!(!sizing.want(of(0, 0)));
        }
        assert!(sizing.want(of(0, 0)) && sizing.has == of(0, 0));
        assert!(sizing.want(of(64, 1)));
    }
}
