//! What the passes of a frame read, once it is prepared: leaves, uniforms and arguments of indirect calls go to the adapter,
//! and the bind groups of whatever had to be made anew. Nothing is recorded yet.

use wgpu::util::DrawIndexedIndirectArgs;

use super::Renderer;
use crate::draw::batch::Run;
use crate::draw::state::{INDIRECT_BYTES, LEAST_MULTI_DRAW};
use crate::draw::uniforms::fixed::StageUniform;
use crate::draw::uniforms::frame::{FrameUniform, LeafUniform};
use crate::gpu::GraphicsContext;

pub(super) fn leaf_buffer(device: &wgpu::Device, leaves: usize) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("leaves"),
        size: (leaves * size_of::<LeafUniform>()) as u64,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

pub(super) fn frame_bind_group(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    uniforms: &wgpu::Buffer,
    leaves: &wgpu::Buffer,
    air: [wgpu::BindGroupEntry<'_>; 5],
    [shadow_maps, shadow_sampler]: [wgpu::BindGroupEntry<'_>; 2],
) -> wgpu::BindGroup {
    let uniform = |size: usize| {
        let size = wgpu::BufferSize::new(size as u64);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: uniforms, offset: 0, size })
    };
    let [sampler, sunlight, sky_light, scattered, mie] = air;
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("frame"),
        layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: uniform(size_of::<FrameUniform>()) },
            wgpu::BindGroupEntry { binding: 1, resource: leaves.as_entire_binding() },
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

pub(super) fn indirect_buffer(device: &wgpu::Device, runs: usize) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("runs"),
        size: runs as u64 * INDIRECT_BYTES,
        usage: wgpu::BufferUsages::INDIRECT | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

impl Renderer {
    pub(super) fn upload(&mut self, ctx: &GraphicsContext) {
        let device = ctx.device();
        let bytes: &[u8] = bytemuck::cast_slice(self.batch.leaves());
        let mut is_new = self.groups.finish(ctx, &self.pipelines) | std::mem::take(&mut self.binds_shadows);
        if bytes.len() as u64 > self.leaf_buffer.size() {
            let leaves = self.batch.leaves().len().next_power_of_two().min(self.most_leaves);
            self.leaf_buffer = leaf_buffer(device, leaves);
            is_new = true;
        }
        if is_new || self.frame_bind_groups.len() != self.atmosphere.set_count() {
            let layout = &self.pipelines.frame_layout;
            let bind_group = |is_drawn, air| {
                let (shadows, air) = (self.shadow_maps.entries(is_drawn), self.atmosphere.entries(air));
                frame_bind_group(device, layout, self.groups.buffer(), &self.leaf_buffer, air, shadows)
            };
            self.caster_bind_group = bind_group(true, 0);
            self.frame_bind_groups = (0..self.atmosphere.set_count()).map(|air| bind_group(false, air)).collect();
        }
        if !bytes.is_empty() {
            ctx.queue().write_buffer(&self.leaf_buffer, 0, bytes);
        }
        // Without runs to draw by one call nothing reads it.
        let has_multi_draw = |same: &[Run]| same.len() >= LEAST_MULTI_DRAW;
        let is_read = self.batch.runs.chunk_by(|a, b| a.bucket == b.bucket).any(has_multi_draw);
        if let Some(indirect) = self.indirect.as_mut().filter(|_| is_read) {
            self.indirect_bytes.clear();
            for run in &self.batch.runs {
                let arguments = DrawIndexedIndirectArgs {
                    index_count: run.index_count,
                    instance_count: run.leaf_count,
                    first_index: run.first_index,
                    base_vertex: run.base_vertex,
                    first_instance: run.first_leaf,
                };
                self.indirect_bytes.extend_from_slice(arguments.as_bytes());
            }
            if self.indirect_bytes.len() as u64 > indirect.size() {
                *indirect = indirect_buffer(device, self.batch.runs.len().next_power_of_two());
            }
            ctx.queue().write_buffer(indirect, 0, &self.indirect_bytes);
        }
    }
}
