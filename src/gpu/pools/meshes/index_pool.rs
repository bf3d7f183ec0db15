//! [`IndexPool`]: the index lists of a device. Equal lists, such as the grid of many tiles, are uploaded once. Draw thread.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::arenas::{Arena, Arenas, ChunkId, ChunkRange};
use super::vertex_packing::fits_short_indices;
use crate::gpu::memory::Memory;
use crate::gpu::pools::allocation::BufferDestination;
use crate::gpu::pools::block_memory::BlockCopy;
use crate::gpu::pools::identity::Identity;
use crate::gpu::pools::slot_table::SlotTable;
use crate::scene::{ContentKey, Mesh};

/// The arena of 32-bit indices.
const LONG: u32 = 0;
/// The arena of 16-bit indices.
const SHORT: u32 = 1;

struct IndexList {
    /// Set while the list is shared by its address: keeps the address from being reused.
    source: Option<Weak<[u32]>>,
    identity: Identity,
    range: ChunkRange,
    /// The largest index, to check other meshes that share the list.
    max_index: u32,
    /// Number of meshes that use the list.
    users: u32,
}

/// The result of an allocation.
pub(super) struct IndexAllocation {
    /// Number of the list.
    pub(super) list: u32,
    /// True if the list must be uploaded.
    pub(super) is_new: bool,
}

/// All index lists of a device.
pub(super) struct IndexPool {
    arenas: Arenas,
    lists: SlotTable<IndexList>,
    /// Never iterated.
    by_identity: HashMap<Identity, u32>,
}

impl Default for IndexPool {
    fn default() -> Self {
        let arena = |element_bytes| Arena::new("indices", wgpu::BufferUsages::INDEX, element_bytes);
        let arenas = Arenas::new([4, 2].map(arena));
        Self { arenas, lists: SlotTable::default(), by_identity: HashMap::new() }
    }
}

fn check_indices(max_index: u32, mesh: &Mesh) -> Result<(), String> {
    if (max_index as usize) < mesh.vertices.len() {
        Ok(())
    } else {
        Err(format!("a mesh of {} vertices has the index {max_index}", mesh.vertices.len()))
    }
}

impl IndexPool {
    /// Allocates a slot for the indices of a mesh, or counts another user of an equal list. Returns an error if an index is
    /// out of range.
    pub(super) fn allocate(
        &mut self,
        memory: &Memory,
        mesh: &Mesh,
        content: Option<&ContentKey>,
    ) -> Result<IndexAllocation, String> {
        let address = Arc::as_ptr(&mesh.indices);
        let identity = Identity::new(content, address);
        let is_same = |list: &IndexList| {
            content.is_some() || list.source.as_ref().is_some_and(|s| std::ptr::addr_eq(s.as_ptr(), address))
        };
        if let Some(&number) = self.by_identity.get(&identity)
            && let Some(list) = self.lists.get_mut(number)
            && is_same(list)
        {
            check_indices(list.max_index, mesh)?;
            list.users += 1;
            return Ok(IndexAllocation { list: number, is_new: false });
        }
        let max_index = mesh.indices.iter().copied().max().unwrap_or(0);
        check_indices(max_index, mesh)?;
        let arena = if fits_short_indices(max_index, mesh.indices.len()) { SHORT } else { LONG };
        let range = self.arenas.allocate(arena, memory, mesh.indices.len())?;
        // A weak pointer keeps the list's memory alive, so it is kept only for lists that others hold as well.
        let by_address = content.is_none() && Arc::strong_count(&mesh.indices) > 1;
        let source = by_address.then(|| Arc::downgrade(&mesh.indices));
        let number = self.lists.insert(IndexList { source, identity, range, max_index, users: 1 });
        if by_address || content.is_some() {
            self.by_identity.insert(identity, number);
        }
        Ok(IndexAllocation { list: number, is_new: true })
    }

    /// Removes one user of a list, and frees it after its last user.
    pub(super) fn release(&mut self, number: u32) {
        let Some(list) = self.lists.get_mut(number) else { return };
        list.users = list.users.saturating_sub(1);
        if list.users > 0 {
            return;
        }
        let Some(list) = self.lists.remove(number) else { return };
        if self.by_identity.get(&list.identity) == Some(&number) {
            self.by_identity.remove(&list.identity);
        }
        self.arenas.release(list.range);
    }

    /// Returns the slot of a list.
    pub(super) fn range(&self, number: u32) -> Option<ChunkRange> {
        self.lists.get(number).map(|list| list.range)
    }

    /// Returns the size of a list's slot in bytes.
    pub(super) fn slot_bytes(&self, number: u32) -> u64 {
        self.range(number).map_or(0, |range| self.arenas.slot_bytes(range))
    }

    pub(super) fn destination(&self, number: u32) -> Option<BufferDestination> {
        self.arenas.destination(self.range(number)?)
    }

    pub(super) fn buffer(&self, chunk: ChunkId) -> Option<(&wgpu::Buffer, wgpu::IndexFormat)> {
        let format = if is_short(chunk) { wgpu::IndexFormat::Uint16 } else { wgpu::IndexFormat::Uint32 };
        self.arenas.buffer(chunk).map(|buffer| (buffer, format))
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

/// Returns true for chunks of 16-bit indices.
pub(super) fn is_short(chunk: ChunkId) -> bool {
    chunk.arena == SHORT
}
