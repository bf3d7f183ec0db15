//! Bind group 0 of all pipelines: the uniforms of frame and stage, leaves, air tables and shadow maps. Draw thread.

use super::frame::FrameUniform;
use super::stage::StageUniform;

/// The resources of a bind group 0, besides air tables and shadow maps.
pub(in crate::draw) struct FrameResources<'a> {
    pub(in crate::draw) layout: &'a wgpu::BindGroupLayout,
    pub(in crate::draw) uniforms: &'a wgpu::Buffer,
    pub(in crate::draw) leaves: &'a wgpu::Buffer,
}

/// Bindings 3 to 7.
pub(in crate::draw) type AirEntries<'a> = [wgpu::BindGroupEntry<'a>; 5];
/// Bindings 8 and 9.
pub(in crate::draw) type ShadowEntries<'a> = [wgpu::BindGroupEntry<'a>; 2];

/// The bind groups 0 of a renderer: one for each set of air tables, and one for passes that draw into shadow maps.
#[derive(Default)]
pub(in crate::draw) struct FrameGroups {
    /// By index of the set of air tables.
    by_air: Vec<wgpu::BindGroup>,
    /// Without air, and with a placeholder for the shadow maps, which are the render target.
    casters: Option<wgpu::BindGroup>,
    is_stale: bool,
}

impl FrameGroups {
    /// Has the groups created again before the next draw, since a resource in them was replaced.
    pub(in crate::draw) fn invalidate(&mut self) {
        self.is_stale = true;
    }

    /// Returns the group of each set of air tables.
    pub(in crate::draw) fn by_air(&self) -> &[wgpu::BindGroup] {
        &self.by_air
    }

    /// Returns the group of passes into shadow maps as a slice of one, since casters have no air.
    pub(in crate::draw) fn casters(&self) -> &[wgpu::BindGroup] {
        self.casters.as_slice()
    }

    /// Creates the groups if they are stale or the number of sets of air tables has changed. `air` and `shadows` return
    /// the bindings of a set, and those of the shadow maps while they are read or drawn into.
    pub(in crate::draw) fn ensure<'a>(
        &mut self,
        device: &wgpu::Device,
        resources: &FrameResources<'_>,
        air_count: usize,
        air: impl Fn(usize) -> AirEntries<'a>,
        shadows: impl Fn(bool) -> ShadowEntries<'a>,
    ) {
        if !self.is_stale && self.by_air.len() == air_count {
            return;
        }
        self.casters = Some(bind_group(device, resources, air(0), shadows(true)));
        self.by_air = (0..air_count).map(|set| bind_group(device, resources, air(set), shadows(false))).collect();
        self.is_stale = false;
    }
}

fn bind_group(
    device: &wgpu::Device,
    resources: &FrameResources<'_>,
    [sampler, sunlight, sky_light, scattered, mie]: AirEntries<'_>,
    [shadow_maps, shadow_sampler]: ShadowEntries<'_>,
) -> wgpu::BindGroup {
    let uniform = |size: usize| {
        let size = wgpu::BufferSize::new(size as u64);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: resources.uniforms, offset: 0, size })
    };
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("frame"),
        layout: resources.layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: uniform(size_of::<FrameUniform>()) },
            wgpu::BindGroupEntry { binding: 1, resource: resources.leaves.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 2, resource: uniform(size_of::<StageUniform>()) },
            sampler,
            sunlight,
            sky_light,
            scattered,
            mie,
            shadow_maps,
            shadow_sampler,
        ],
    })
}
