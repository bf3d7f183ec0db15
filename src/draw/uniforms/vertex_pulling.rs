//! Bind group 3: the buffers of the mesh pool from which shaders fetch the vertices of small meshes. Draw thread.

use std::collections::HashMap;

use crate::gpu::GraphicsContext;

/// Frames after which an unused group is dropped, and with it its references to buffers.
const KEPT_FRAMES: u32 = 60;

struct PulledBuffers {
    /// Compared at each use, since the number of a chunk may be reused for another buffer.
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
    used: u32,
}

/// The bind groups 3 of a renderer, by vertex and index chunk.
#[derive(Default)]
pub(in crate::draw) struct VertexPulling {
    groups: HashMap<(u32, u32), PulledBuffers>,
    frame: u32,
}

impl VertexPulling {
    /// Starts a frame and drops groups that were not used for long.
    pub(in crate::draw) fn start_frame(&mut self) {
        self.frame = self.frame.wrapping_add(1);
        let frame = self.frame;
        self.groups.retain(|_, pull| frame.wrapping_sub(pull.used) <= KEPT_FRAMES);
    }

    /// Creates the group of a vertex and an index chunk if needed, and marks it as used.
    pub(in crate::draw) fn ensure(
        &mut self,
        ctx: &GraphicsContext,
        layout: &wgpu::BindGroupLayout,
        chunks: (u32, u32),
    ) {
        let meshes = &ctx.pools().meshes();
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
        self.groups.insert(chunks, PulledBuffers { vertices, indices, bind_group, used: self.frame });
    }

    pub(in crate::draw) fn get(&self, chunks: (u32, u32)) -> Option<&wgpu::BindGroup> {
        self.groups.get(&chunks).map(|pull| &pull.bind_group)
    }
}
