//! [`Arena`]: buffers cut into slots of one size class each, and [`Arenas`]: one arena per element format. Draw thread.
//!
//! A buffer (a chunk) has slots of a single size, so that it cannot fragment. Meshes of similar size, such as all tiles of a
//! set, are drawn from one buffer without a change of state.

use crate::gpu::memory::Memory;
use crate::gpu::pools::allocation::BufferDestination;
use crate::gpu::pools::block_memory::{BlockCopy, BlockLimits, BlockMemory};
use crate::gpu::pools::slot_allocator::{SlotAllocator, size_class};
use crate::gpu::pools::slot_table::SlotTable;

/// The maximum size of a buffer.
const CHUNK_BYTES: u64 = 8 << 20;
/// The maximum number of slots in a buffer.
const MAX_CHUNK_SLOTS: u32 = 4096;

/// A chunk of one of the arenas. Other folders know it by its [`Self::number`] alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ChunkId {
    /// Index of the arena; below 32.
    pub(super) arena: u32,
    /// Number of the chunk in its arena; below 2^27.
    chunk: u32,
}

impl ChunkId {
    /// The arena lies in the bits above these.
    const ARENA_SHIFT: u32 = 27;

    /// Returns a number that no other chunk of these arenas has.
    pub(super) fn number(self) -> u32 {
        self.chunk | self.arena << Self::ARENA_SHIFT
    }

    pub(super) fn from_number(number: u32) -> Self {
        Self { arena: number >> Self::ARENA_SHIFT, chunk: number & ((1 << Self::ARENA_SHIFT) - 1) }
    }
}

/// A slot in a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ChunkRange {
    pub(super) chunk: ChunkId,
    slot: u32,
    /// Index of the first element, counted from the start of the buffer.
    pub(super) first: u32,
}

struct Chunk {
    memory: BlockMemory<wgpu::Buffer>,
    /// Number of elements of a slot.
    class: u32,
    slots: SlotAllocator,
}

impl Chunk {
    /// Returns the size of all memory of the chunk in bytes.
    fn bytes(&self) -> u64 {
        self.memory.all().map(wgpu::Buffer::size).sum()
    }
}

/// Buffers of elements of one format.
pub(super) struct Arena {
    label: &'static str,
    usage: wgpu::BufferUsages,
    element_bytes: u64,
    chunks: SlotTable<Chunk>,
    /// Copies of chunks that have grown, to be queued.
    copies: Vec<BlockCopy>,
    bytes_in_use: u64,
    bytes_allocated: u64,
}

impl Arena {
    pub(super) fn new(label: &'static str, usage: wgpu::BufferUsages, element_bytes: u64) -> Self {
        let (chunks, copies) = (SlotTable::default(), Vec::new());
        Self { label, usage, element_bytes, chunks, copies, bytes_in_use: 0, bytes_allocated: 0 }
    }

    pub(super) fn is_unused(&self) -> bool {
        self.bytes_in_use == 0
    }

    /// Allocates `length` elements. Returns the number of the chunk in this arena and the slot.
    fn allocate(&mut self, memory: &Memory, length: usize) -> Result<(u32, u32, u32), String> {
        let too_large = || format!("{length} {} do not fit into one buffer of the adapter", self.label);
        // A base vertex is an i32.
        let length = u32::try_from(length).ok().filter(|l| *l < 1 << 30).ok_or_else(too_large)?;
        let class = size_class(length);
        let class_bytes = u64::from(class) * self.element_bytes;
        let max_bytes = memory.limits().max_buffer_size;
        if class_bytes > max_bytes {
            return Err(too_large());
        }
        let max_bytes = CHUNK_BYTES.min(max_bytes);
        let room_bytes = memory.room_bytes();
        let limits = BlockLimits { slot_bytes: class_bytes, max_bytes, max_slots: MAX_CHUNK_SLOTS, room_bytes };
        let (mut slots_of_class, mut growable) = (0, None);
        for (number, chunk) in self.chunks.iter_mut().filter(|(_, chunk)| chunk.class == class) {
            slots_of_class += chunk.slots.capacity();
            if let Some(slot) = chunk.slots.allocate() {
                self.bytes_in_use += class_bytes;
                return Ok((number, slot, slot * class));
            }
            growable = growable.or(limits.grown(chunk.slots.capacity()).map(|capacity| (number, capacity)));
        }
        if let Some((number, capacity)) = growable
            && let Some(slot) = self.grow(memory, number, capacity)
        {
            self.bytes_in_use += class_bytes;
            return Ok((number, slot, slot * class));
        }
        let capacity = limits.first(slots_of_class);
        let buffer = self.create_buffer(memory, class_bytes * u64::from(capacity))?;
        let mut slots = SlotAllocator::new(capacity);
        let slot = slots.allocate().ok_or("a buffer without slots")?;
        self.bytes_allocated += buffer.size();
        self.bytes_in_use += class_bytes;
        let number = self.chunks.insert(Chunk { memory: BlockMemory::new(buffer), class, slots });
        Ok((number, slot, slot * class))
    }

    fn create_buffer(&self, memory: &Memory, size: u64) -> Result<wgpu::Buffer, String> {
        let uses = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
        let usage = self.usage | uses;
        let descriptor = wgpu::BufferDescriptor { label: Some(self.label), size, usage, mapped_at_creation: false };
        memory.allocate(self.label, size, |device| device.create_buffer(&descriptor))
    }

    /// Grows a chunk and takes one of its new slots. Returns `None` if there is no memory for that.
    fn grow(&mut self, memory: &Memory, number: u32, capacity: u32) -> Option<u32> {
        let class_bytes = self.slot_bytes(number);
        let to = self.create_buffer(memory, class_bytes * u64::from(capacity)).ok()?;
        let chunk = self.chunks.get_mut(number)?;
        self.copies.push(BlockCopy::Buffer { from: chunk.memory.newest().clone(), to: to.clone() });
        self.bytes_allocated += to.size();
        chunk.memory.grow(to);
        chunk.slots.grow(capacity);
        chunk.slots.allocate()
    }

    /// Has frames read what was copied to a buffer, or to all if it is `None`.
    fn copied(&mut self, to: Option<&wgpu::Buffer>) {
        for (_, chunk) in self.chunks.iter_mut() {
            let bytes_before = chunk.bytes();
            chunk.memory.copied(|oldest| to.is_none_or(|to| oldest == to));
            self.bytes_allocated -= bytes_before - chunk.bytes();
        }
    }

    fn slot_bytes(&self, chunk: u32) -> u64 {
        self.chunks.get(chunk).map_or(0, |chunk| u64::from(chunk.class) * self.element_bytes)
    }

    fn release(&mut self, number: u32, slot: u32) {
        let bytes = self.slot_bytes(number);
        if let Some(chunk) = self.chunks.get_mut(number) {
            chunk.slots.release(slot);
            self.bytes_in_use -= bytes;
            if chunk.slots.is_empty() {
                self.bytes_allocated -= chunk.bytes();
                self.chunks.remove(number);
            }
        }
    }

    fn buffer(&self, chunk: u32) -> Option<&wgpu::Buffer> {
        self.chunks.get(chunk).map(|chunk| chunk.memory.drawn())
    }
}

/// The arenas of several formats.
pub(super) struct Arenas(Vec<Arena>);

impl Arenas {
    pub(super) fn new(arenas: impl Into<Vec<Arena>>) -> Self {
        Self(arenas.into())
    }

    pub(super) fn push(&mut self, arena: Arena) {
        self.0.push(arena);
    }

    pub(super) fn iter_mut(&mut self) -> std::slice::IterMut<'_, Arena> {
        self.0.iter_mut()
    }

    /// Allocates `length` elements in an arena.
    pub(super) fn allocate(&mut self, arena: u32, memory: &Memory, length: usize) -> Result<ChunkRange, String> {
        let format = self.0.get_mut(arena as usize).ok_or("a format without buffers")?;
        let (chunk, slot, first) = format.allocate(memory, length)?;
        Ok(ChunkRange { chunk: ChunkId { arena, chunk }, slot, first })
    }

    fn arena(&self, chunk: ChunkId) -> Option<&Arena> {
        self.0.get(chunk.arena as usize)
    }

    /// Returns the size of a slot in bytes.
    pub(super) fn slot_bytes(&self, range: ChunkRange) -> u64 {
        self.arena(range.chunk).map_or(0, |arena| arena.slot_bytes(range.chunk.chunk))
    }

    /// Takes the copies that must be queued before further uploads.
    pub(super) fn take_copies(&mut self) -> impl Iterator<Item = BlockCopy> + '_ {
        self.0.iter_mut().flat_map(|arena| arena.copies.drain(..))
    }

    /// Returns true while a copy is not recorded.
    pub(super) fn is_copying(&mut self) -> bool {
        self.0.iter_mut().any(|arena| arena.chunks.iter_mut().any(|(_, chunk)| chunk.memory.is_copying()))
    }

    /// Has frames read what was copied to a buffer, or to all if it is `None`.
    pub(super) fn copied(&mut self, to: Option<&wgpu::Buffer>) {
        self.0.iter_mut().for_each(|arena| arena.copied(to));
    }

    /// Frees a slot, and its buffer after the last slot.
    pub(super) fn release(&mut self, range: ChunkRange) {
        if let Some(arena) = self.0.get_mut(range.chunk.arena as usize) {
            arena.release(range.chunk.chunk, range.slot);
        }
    }

    pub(super) fn destination(&self, range: ChunkRange) -> Option<BufferDestination> {
        let arena = self.arena(range.chunk)?;
        let buffer = arena.chunks.get(range.chunk.chunk)?.memory.newest().clone();
        Some(BufferDestination { buffer, offset: u64::from(range.first) * arena.element_bytes })
    }

    pub(super) fn buffer(&self, chunk: ChunkId) -> Option<&wgpu::Buffer> {
        self.arena(chunk)?.buffer(chunk.chunk)
    }

    pub(super) fn bytes_in_use(&self) -> u64 {
        self.0.iter().map(|arena| arena.bytes_in_use).sum()
    }

    pub(super) fn bytes_allocated(&self) -> u64 {
        self.0.iter().map(|arena| arena.bytes_allocated).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunk_numbers_hold_arena_and_chunk() {
        for id in [(0, 0), (1, 5), (17, (1 << 27) - 1)].map(|(arena, chunk)| ChunkId { arena, chunk }) {
            assert_eq!(ChunkId::from_number(id.number()), id);
        }
    }
}
