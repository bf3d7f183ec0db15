//! Group 3 of the pipelines: buffers of the mesh pool from which small meshes fetch their vertices. Draw thread.

use std::collections::HashMap;

use crate::gpu::GraphicsContext;

/// Frames after which a group that was not used is let go, and with it the buffers it holds.
const KEPT_FRAMES: u32 = 60;

struct Pull {
    /// A chunk's number may come to mean another buffer.
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
    used: u32,
}

/// Bind groups by vertex and index chunk.
#[derive(Default)]
pub(in crate::draw) struct Pulls {
    groups: HashMap<(u32, u32), Pull>,
    frame: u32,
}

impl Pulls {
    pub(in crate::draw) fn start_frame(&mut self) {
        self.frame = self.frame.wrapping_add(1);
        let frame = self.frame;
        self.groups.retain(|_, pull| frame.wrapping_sub(pull.used) <= KEPT_FRAMES);
    }

    /// Makes the group of two chunks unless it is there.
    pub(in crate::draw) fn ensure(
        &mut self,
        ctx: &GraphicsContext,
        layout: &wgpu::BindGroupLayout,
        chunks: (u32, u32),
    ) {
        let meshes = &ctx.pools().meshes;
        // Both as they come: small meshes are not packed.
        let (Some(vertices), Some((indices, _))) = (meshes.vertex_buffer(chunks.0), meshes.index_buffer(chunks.1))
        else {
            return;
        };
        if let Some(pull) = self.groups.get_mut(&chunks)
            && pull.vertices == *vertices
            && pull.indices == *indices
        {
            pull.used = self.frame;
            return;
        }
        let bind_group = ctx.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("pulled meshes"),
            layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: vertices.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: indices.as_entire_binding() },
            ],
        });
        let (vertices, indices) = (vertices.clone(), indices.clone());
        self.groups.insert(chunks, Pull { vertices, indices, bind_group, used: self.frame });
    }

    pub(in crate::draw) fn get(&self, chunks: (u32, u32)) -> Option<&wgpu::BindGroup> {
        self.groups.get(&chunks).map(|pull| &pull.bind_group)
    }
}
