//! [`VertexBuffers`]: the vertex buffers of a device, in one arena for each vertex format and for each layout of custom
//! attributes. Draw thread.

use std::sync::Arc;

use super::arenas::{Arena, Arenas, ChunkId, ChunkRange};
use super::vertex_packing::VertexFormat;
use crate::gpu::memory::Memory;
use crate::gpu::pools::allocation::BufferDestination;
use crate::gpu::pools::block_memory::BlockCopy;
use crate::scene::{AttributeLayout, Mesh, added_stride};

/// The formats of the first arenas, in the order of their discriminants.
const FORMATS: [VertexFormat; 3] = [VertexFormat::Full, VertexFormat::Packed, VertexFormat::Quantized];
/// The maximum number of attribute layouts in use: a pipeline key has four bits for them, and one value means none.
pub(crate) const MAX_ATTRIBUTE_LAYOUTS: usize = 15;

/// The arenas of [`FORMATS`], followed by one arena per attribute layout.
pub(super) struct VertexBuffers {
    arenas: Arenas,
    /// By index of the arena, counted from the end of [`FORMATS`].
    layouts: Vec<Arc<AttributeLayout>>,
}

impl Default for VertexBuffers {
    fn default() -> Self {
        let arenas = FORMATS.map(|format| vertex_arena(format.stride()));
        Self { arenas: Arenas::new(arenas), layouts: Vec::new() }
    }
}

fn vertex_arena(stride: usize) -> Arena {
    Arena::new("vertices", wgpu::BufferUsages::VERTEX, stride as u64)
}

impl VertexBuffers {
    /// Returns the arena for the vertices of a mesh.
    pub(super) fn arena_of(&mut self, mesh: &Mesh, format: VertexFormat) -> Result<u32, String> {
        if mesh.attributes.is_empty() {
            return Ok(format as u32);
        }
        mesh.attributes.check(mesh.vertices.len()).map_err(|error| error.to_string())?;
        let index = self.attribute_layout_index(mesh.attributes.layout()).ok_or_else(|| {
            let names: Vec<&str> = mesh.attributes.iter().map(|(name, ..)| name).collect();
            format!(
                "a mesh with the attributes {names:?}: there are {MAX_ATTRIBUTE_LAYOUTS} other lists of attributes in use"
            )
        })?;
        Ok(FORMATS.len() as u32 - 1 + index)
    }

    /// Returns the index of an attribute layout, from 1. It is stable while vertices of that layout are resident; after that
    /// another layout may get it. Returns `None` if [`MAX_ATTRIBUTE_LAYOUTS`] others are in use.
    pub(super) fn attribute_layout_index(&mut self, layout: &Arc<AttributeLayout>) -> Option<u32> {
        if let Some(known) = self.layouts.iter().position(|known| known == layout) {
            return Some(known as u32 + 1);
        }
        let arena = vertex_arena(VertexFormat::Full.stride() + added_stride(layout));
        if self.layouts.len() < MAX_ATTRIBUTE_LAYOUTS {
            self.layouts.push(layout.clone());
            self.arenas.push(arena);
            return Some(self.layouts.len() as u32);
        }
        let arenas = self.arenas.iter_mut().skip(FORMATS.len());
        let (unused, index) = arenas.zip(0..).find(|(arena, _)| arena.is_unused())?;
        *unused = arena;
        self.layouts[index] = layout.clone();
        Some(index as u32 + 1)
    }

    /// Allocates vertices in an arena that [`Self::arena_of`] returned.
    pub(super) fn allocate(&mut self, arena: u32, memory: &Memory, count: usize) -> Result<ChunkRange, String> {
        self.arenas.allocate(arena, memory, count)
    }

    pub(super) fn release(&mut self, range: ChunkRange) {
        self.arenas.release(range);
    }

    pub(super) fn slot_bytes(&self, range: ChunkRange) -> u64 {
        self.arenas.slot_bytes(range)
    }

    pub(super) fn destination(&self, range: ChunkRange) -> Option<BufferDestination> {
        self.arenas.destination(range)
    }

    pub(super) fn buffer(&self, chunk: ChunkId) -> Option<&wgpu::Buffer> {
        self.arenas.buffer(chunk)
    }

    /// Returns the vertex format of a chunk.
    pub(super) fn format_of(&self, chunk: ChunkId) -> VertexFormat {
        FORMATS.get(chunk.arena as usize).copied().unwrap_or_default()
    }

    /// Returns the attribute layout of a chunk with its index, if the chunk has custom attributes.
    pub(super) fn attribute_layout_of(&self, chunk: ChunkId) -> Option<(u32, &Arc<AttributeLayout>)> {
        let index = (chunk.arena as usize + 1).checked_sub(FORMATS.len())?;
        Some((index as u32, self.layouts.get(index.checked_sub(1)?)?))
    }

    /// Takes the copies that must be queued before further uploads.
    pub(super) fn take_copies(&mut self) -> impl Iterator<Item = BlockCopy> + '_ {
        self.arenas.take_copies()
    }

    /// Returns true while a copy is not recorded.
    pub(super) fn is_copying(&mut self) -> bool {
        self.arenas.is_copying()
    }

    /// Has frames read what was copied to a buffer, or to all if it is `None`.
    pub(super) fn copied(&mut self, to: Option<&wgpu::Buffer>) {
        self.arenas.copied(to);
    }

    pub(super) fn bytes_in_use(&self) -> u64 {
        self.arenas.bytes_in_use()
    }

    pub(super) fn bytes_allocated(&self) -> u64 {
        self.arenas.bytes_allocated()
    }
}
