//! [`MeshPool`]: all meshes of a device. Equal meshes are uploaded once and shared by reference count. Draw thread.
//!
//! Vertices and indices are stored as they are, or packed where nothing is lost (`vertex_packing.rs`).

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::arenas::{ChunkId, ChunkRange};
use super::index_pool::{IndexPool, is_short};
use super::vertex_buffers::VertexBuffers;
use super::vertex_packing::{VertexFormat, WHITE};
use crate::gpu::memory::Memory;
use crate::gpu::pools::allocation::BufferDestination;
use crate::gpu::pools::block_memory::BlockCopy;
use crate::gpu::pools::identity::Identity;
use crate::gpu::pools::slot_table::SlotTable;
use crate::scene::{AttributeLayout, Mesh, SharedParts};

struct ResidentMesh {
    /// Keeps the address from being reused for another mesh while the entry exists.
    source: Weak<Mesh>,
    identity: Identity,
    vertices: ChunkRange,
    /// Number of the index list.
    indices: u32,
    /// Number of drawables that use the mesh.
    users: u32,
}

/// The slot of a mesh, as a draw needs it. Chunks are numbers that only the pool interprets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MeshSlot {
    /// Equal for drawables that share a mesh.
    pub(crate) mesh: u32,
    pub(crate) vertex_chunk: u32,
    pub(crate) index_chunk: u32,
    pub(crate) base_vertex: i32,
    pub(crate) first_index: u32,
    pub(crate) index_count: u32,
}

/// A mesh with its slot, and the parts of it that must be uploaded.
pub(in crate::gpu) struct MeshAllocation {
    pub(in crate::gpu) slot: MeshSlot,
    /// True if the vertices must be uploaded.
    pub(in crate::gpu) has_new_vertices: bool,
    /// True if the index list must be uploaded.
    pub(in crate::gpu) has_new_indices: bool,
    /// Size of the slot of the vertices in bytes, new or not.
    pub(in crate::gpu) vertex_bytes: u64,
    /// Size of the slot of the indices in bytes, new or not.
    pub(in crate::gpu) index_bytes: u64,
}

/// All meshes of a device.
#[derive(Default)]
pub(crate) struct MeshPool {
    vertices: VertexBuffers,
    indices: IndexPool,
    /// The colour of packed and quantized vertices; created with the first of them.
    white: Option<wgpu::Buffer>,
    meshes: SlotTable<ResidentMesh>,
    /// Never iterated.
    by_identity: HashMap<Identity, u32>,
}

impl MeshPool {
    /// Allocates slots for a mesh, or counts another user of an equal mesh. Returns an error if the mesh is empty, has an
    /// index out of range or does not fit into memory.
    pub(in crate::gpu::pools) fn allocate(
        &mut self,
        memory: &Memory,
        mesh: &Arc<Mesh>,
        shared: &SharedParts,
        format: VertexFormat,
    ) -> Result<MeshAllocation, String> {
        let content = shared.geometry.as_ref().map(|s| &s.key);
        let identity = Identity::new(content, Arc::as_ptr(mesh));
        if let Some(&number) = self.by_identity.get(&identity)
            && let Some(resident) = self.meshes.get_mut(number)
            && (content.is_some() || std::ptr::eq(resident.source.as_ptr(), Arc::as_ptr(mesh)))
        {
            resident.users += 1;
            let (vertices, indices) = (resident.vertices, resident.indices);
            return self.allocation(number, vertices, indices, mesh, [false, false]);
        }
        if mesh.vertices.is_empty() || mesh.indices.is_empty() {
            return Err("a mesh without vertices or indices".into());
        }
        let arena = self.vertices.arena_of(mesh, format)?;
        let indices = self.indices.allocate(memory, mesh, shared.indices.as_ref().map(|s| &s.key))?;
        let white = self.ensure_white(memory, format);
        let vertices = white.and_then(|()| self.vertices.allocate(arena, memory, mesh.vertices.len()));
        let vertices = match vertices {
            Ok(range) => range,
            Err(error) => {
                self.indices.release(indices.list);
                return Err(error);
            }
        };
        let resident =
            ResidentMesh { source: Arc::downgrade(mesh), identity, vertices, indices: indices.list, users: 1 };
        let number = self.meshes.insert(resident);
        self.by_identity.insert(identity, number);
        self.allocation(number, vertices, indices.list, mesh, [true, indices.is_new])
    }

    /// Creates the white vertex colour that the packed formats need.
    fn ensure_white(&mut self, memory: &Memory, format: VertexFormat) -> Result<(), String> {
        if format != VertexFormat::Full && self.white.is_none() {
            self.white = Some(memory.allocate_filled("white vertex", wgpu::BufferUsages::VERTEX, &WHITE)?);
        }
        Ok(())
    }

    fn allocation(
        &self,
        number: u32,
        vertices: ChunkRange,
        index_list: u32,
        mesh: &Mesh,
        [has_new_vertices, has_new_indices]: [bool; 2],
    ) -> Result<MeshAllocation, String> {
        let indices = self.indices.range(index_list).ok_or("the index list of a resident mesh is missing")?;
        let slot = MeshSlot {
            mesh: number,
            vertex_chunk: vertices.chunk.number(),
            index_chunk: indices.chunk.number(),
            base_vertex: vertices.first as i32,
            first_index: indices.first,
            index_count: mesh.indices.len() as u32,
        };
        let (vertex_bytes, index_bytes) = (self.vertices.slot_bytes(vertices), self.indices.slot_bytes(index_list));
        Ok(MeshAllocation { slot, has_new_vertices, has_new_indices, vertex_bytes, index_bytes })
    }

    /// Returns the index of an attribute layout, from 1. It is stable while vertices of that layout are resident. Returns
    /// `None` if too many other layouts are in use.
    pub(in crate::gpu) fn attribute_layout_index(&mut self, layout: &Arc<AttributeLayout>) -> Option<u32> {
        self.vertices.attribute_layout_index(layout)
    }

    pub(in crate::gpu) fn vertex_destination(&self, slot: &MeshSlot) -> Option<BufferDestination> {
        self.vertices.destination(self.meshes.get(slot.mesh)?.vertices)
    }

    pub(in crate::gpu) fn index_destination(&self, slot: &MeshSlot) -> Option<BufferDestination> {
        self.indices.destination(self.meshes.get(slot.mesh)?.indices)
    }

    /// Removes one user of a mesh, and frees it after its last user.
    pub(in crate::gpu::pools) fn release(&mut self, slot: &MeshSlot) {
        let Some(resident) = self.meshes.get_mut(slot.mesh) else { return };
        resident.users = resident.users.saturating_sub(1);
        if resident.users > 0 {
            return;
        }
        let Some(resident) = self.meshes.remove(slot.mesh) else { return };
        if self.by_identity.get(&resident.identity) == Some(&slot.mesh) {
            self.by_identity.remove(&resident.identity);
        }
        self.vertices.release(resident.vertices);
        self.indices.release(resident.indices);
    }

    pub(crate) fn vertex_buffer(&self, vertex_chunk: u32) -> Option<&wgpu::Buffer> {
        self.vertices.buffer(ChunkId::from_number(vertex_chunk))
    }

    pub(crate) fn index_buffer(&self, index_chunk: u32) -> Option<(&wgpu::Buffer, wgpu::IndexFormat)> {
        self.indices.buffer(ChunkId::from_number(index_chunk))
    }

    /// Returns true for chunks of 16-bit indices.
    pub(in crate::gpu) fn has_short_indices(&self, index_chunk: u32) -> bool {
        is_short(ChunkId::from_number(index_chunk))
    }

    /// Returns the vertex format of a chunk.
    pub(crate) fn format_of(&self, vertex_chunk: u32) -> VertexFormat {
        self.vertices.format_of(ChunkId::from_number(vertex_chunk))
    }

    /// Returns the attribute layout of a chunk with its index, if the chunk has custom attributes.
    pub(crate) fn attribute_layout_of(&self, vertex_chunk: u32) -> Option<(u32, &Arc<AttributeLayout>)> {
        self.vertices.attribute_layout_of(ChunkId::from_number(vertex_chunk))
    }

    /// Returns a buffer with one white vertex colour; `None` before the first packed mesh.
    pub(crate) fn white(&self) -> Option<&wgpu::Buffer> {
        self.white.as_ref()
    }

    /// Takes the copies that must be queued before further uploads.
    pub(in crate::gpu::pools) fn take_copies(&mut self) -> impl Iterator<Item = BlockCopy> + '_ {
        self.vertices.take_copies().chain(self.indices.take_copies())
    }

    /// Returns true while a copy is not recorded.
    pub(in crate::gpu::pools) fn is_copying(&mut self) -> bool {
        self.vertices.is_copying() || self.indices.is_copying()
    }

    /// Has frames read what was copied to a buffer, or to all if it is `None`.
    pub(in crate::gpu::pools) fn copied(&mut self, to: Option<&wgpu::Buffer>) {
        self.vertices.copied(to);
        self.indices.copied(to);
    }

    pub(in crate::gpu::pools) fn bytes_in_use(&self) -> u64 {
        self.vertices.bytes_in_use() + self.indices.bytes_in_use()
    }

    pub(in crate::gpu::pools) fn bytes_allocated(&self) -> u64 {
        self.vertices.bytes_allocated() + self.indices.bytes_allocated()
    }
}
