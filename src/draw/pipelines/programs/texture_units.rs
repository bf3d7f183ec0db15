//! The texture units that programs declare, and the layout of their bind group.

use crate::state::{CompareFunction, FilterMode, Sampler, TEXTURE_UNITS};

/// A texture that a program declares, and its sampler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) struct UnitLayout {
    pub(in crate::draw) dimension: wgpu::TextureViewDimension,
    pub(in crate::draw) is_depth: bool,
    pub(in crate::draw) is_filtered: bool,
    pub(super) has_sampler: bool,
    /// True if the sampler compares depths.
    pub(super) compares: bool,
}

impl UnitLayout {
    /// Returns the given sampler as far as the program can use it; `None` if only one of the two compares.
    pub(in crate::draw) fn sampler(&self, given: &Sampler) -> Option<Sampler> {
        if self.has_sampler && self.compares != given.compare.is_some() {
            return None;
        }
        // Depths that are not compared cannot be interpolated.
        let nearest = FilterMode::Nearest;
        let is_plain = self.is_depth && !self.compares;
        Some(if is_plain {
            Sampler { min_filter: nearest, mag_filter: nearest, mip_filter: nearest, ..*given }
        } else {
            *given
        })
    }

    /// Returns the sampler for units without a texture.
    pub(in crate::draw) fn own_sampler(&self) -> Sampler {
        let compare = self.compares.then_some(CompareFunction::LessOrEqual);
        let own = Sampler { compare, ..Sampler::default() };
        self.sampler(&own).unwrap_or(own)
    }

    /// Returns true if the program declares a sampler for the texture.
    pub(in crate::draw) fn has_sampler(&self) -> bool {
        self.has_sampler
    }
}

/// Returns the layout of bind group 2: uniforms at 0, texture and sampler of unit n at 2 n + 1 and 2 n + 2.
pub(super) fn bindings(
    uniform_bytes: usize,
    units: &[Option<UnitLayout>; TEXTURE_UNITS],
) -> Vec<wgpu::BindGroupLayoutEntry> {
    let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry { binding, visibility: both, ty, count: None };
    let mut entries = Vec::new();
    if uniform_bytes > 0 {
        let ty = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: true,
            min_binding_size: None,
        };
        entries.push(entry(0, ty));
    }
    for (unit, layout) in (0u32..).zip(units) {
        let Some(layout) = layout else { continue };
        let sample_type = if layout.is_depth {
            wgpu::TextureSampleType::Depth
        } else {
            wgpu::TextureSampleType::Float { filterable: layout.is_filtered }
        };
        let ty = wgpu::BindingType::Texture { sample_type, view_dimension: layout.dimension, multisampled: false };
        entries.push(entry(1 + 2 * unit, ty));
        if layout.has_sampler {
            let kind = match (layout.compares, layout.is_depth) {
                (true, _) => wgpu::SamplerBindingType::Comparison,
                (false, true) => wgpu::SamplerBindingType::NonFiltering,
                (false, false) => wgpu::SamplerBindingType::Filtering,
            };
            entries.push(entry(2 + 2 * unit, wgpu::BindingType::Sampler(kind)));
        }
    }
    entries
}
