//! What the passes of a frame read, once it is prepared: leaves, uniforms and arguments of indirect calls go to the adapter,
//! and the bind groups of whatever had to be made anew. Nothing is recorded yet.

use wgpu::util::DrawIndexedIndirectArgs;

use super::Renderer;
use crate::draw::batch::Run;
use crate::draw::plan::StagePlan;
use crate::draw::state::{INDIRECT_BYTES, LEAST_MULTI_DRAW};
use crate::draw::uniforms::fixed::StageUniform;
use crate::draw::uniforms::frame::{FrameUniform, LeafUniform};
use crate::gpu::GraphicsContext;

/// What there is room for at first.
const LEAST_LEAVES: usize = 256;
const LEAST_RUNS: usize = 64;

fn leaf_buffer(device: &wgpu::Device, size: u64) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("leaves"),
        size,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

fn frame_bind_group(
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

fn indirect_buffer(device: &wgpu::Device, size: u64) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("runs"),
        size,
        usage: wgpu::BufferUsages::INDIRECT | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

impl Renderer {
    /// Makes room for a frame's leaves, as far as the adapter has memory for them.
    pub(super) fn reserve_leaves(&mut self, ctx: &GraphicsContext, wanted: usize) {
        const BYTES: u64 = size_of::<LeafUniform>() as u64;
        let has = self.leaf_buffer.as_ref().map_or(0, |buffer| (buffer.size() / BYTES) as usize);
        self.leaf_room = has.min(self.most_leaves);
        if wanted.min(self.most_leaves) <= has && has > 0 {
            return;
        }
        let leaves = wanted.next_power_of_two().max(LEAST_LEAVES).min(self.most_leaves);
        let size = leaves as u64 * BYTES;
        match ctx.memory().make("leaves", size, |device| leaf_buffer(device, size)) {
            Ok(buffer) => {
                (self.leaf_buffer, self.leaf_room, self.binds_anew) = (Some(buffer), leaves, true);
            }
            Err(error) => self.complain(error),
        }
    }

    /// Why nothing can be drawn.
    pub(super) fn upload(&mut self, ctx: &GraphicsContext) -> Result<(), String> {
        let device = ctx.device();
        self.binds_anew |= self.groups.finish(ctx, &self.pipelines)?;
        let (Some(uniforms), Some(leaf_buffer)) = (self.groups.buffer(), &self.leaf_buffer) else {
            // Which has been said.
            return Err(String::new());
        };
        if self.binds_anew || self.frame_bind_groups.len() != self.atmosphere.place_count() {
            let layout = &self.pipelines.frame_layout;
            let bind_group = |is_drawn, air| {
                let (shadows, air) = (self.shadow_maps.entries(is_drawn), self.atmosphere.entries(air));
                frame_bind_group(device, layout, uniforms, leaf_buffer, air, shadows)
            };
            self.caster_bind_group = Some(bind_group(true, 0));
            self.frame_bind_groups = (0..self.atmosphere.place_count()).map(|air| bind_group(false, air)).collect();
            self.binds_anew = false;
        }
        let bytes: &[u8] = bytemuck::cast_slice(self.batch.leaves());
        if !bytes.is_empty() {
            ctx.queue().write_buffer(leaf_buffer, 0, bytes);
        }
        // Without runs to draw by one call nothing reads it.
        let has_multi_draw = |same: &[Run]| same.len() >= LEAST_MULTI_DRAW;
        let is_read = self.batch.runs.chunk_by(|a, b| a.bucket == b.bucket).any(has_multi_draw);
        if is_read && self.has_indirect {
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
            let needed = self.indirect_bytes.len() as u64;
            if self.indirect.as_ref().is_none_or(|buffer| buffer.size() < needed) {
                let size = INDIRECT_BYTES * self.batch.runs.len().next_power_of_two().max(LEAST_RUNS) as u64;
                let made = ctx.memory().make("arguments of draws", size, |device| indirect_buffer(device, size));
                // Without it each run is a call of its own.
                self.indirect = made.map_err(|error| self.complain(error)).ok();
            }
            if let Some(indirect) = &self.indirect {
                ctx.queue().write_buffer(indirect, 0, &self.indirect_bytes);
            }
        }
        Ok(())
    }

    /// Draws nothing in a frame that is prepared: what it is drawn from cannot be.
    pub(super) fn leave_out(&mut self) {
        self.stages_refused = self.plans.len() as u32;
        self.plans.fill_with(StagePlan::default);
        self.batch.start_frame();
        self.query_boxes.clear();
        (self.shadow_leaves, self.leaves_dropped, self.shadow_leaves_dropped) = (0, 0, 0);
        if let Some(queries) = &mut self.queries {
            queries.forget_asked();
        }
    }
}
