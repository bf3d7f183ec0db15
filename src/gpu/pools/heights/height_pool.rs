//! [`HeightPool`]: all height tiles of a device, in blocks of equal tiles. Draw thread.
//!
//! A slot of a block is a layer of heights, a layer of colour and a table. A block has one bind group, so that the tiles of
//! a block that are drawn one after the other are a single instanced draw of the shared grid. Tiles of equal content share
//! a slot by reference count.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use super::height_grid::HeightGrid;
use super::height_table::table_bytes;
use crate::gpu::memory::Memory;
use crate::gpu::pools::allocation::{Allocation, BufferDestination, LayerDestination};
use crate::gpu::pools::bind_group_layouts::BindGroupLayouts;
use crate::gpu::pools::block_memory::{BlockCopy, BlockLimits, BlockMemory};
use crate::gpu::pools::slot_allocator::SlotAllocator;
use crate::gpu::pools::slot_table::SlotTable;
use crate::gpu::pools::textures::{ImageSize, array_view};
use crate::gpu::pools::wgpu_enums::TexelEncoding;
use crate::scene::{BlockFormats, ContentKey, HeightTile, Sampling};

/// The maximum size of a block.
const BLOCK_BYTES: u64 = 24 << 20;
/// The maximum number of tiles in a block; WebGPU guarantees 256 layers.
const MAX_BLOCK_TILES: u32 = 128;

/// The slot of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct HeightSlot {
    pub(crate) block: u32,
    pub(crate) layer: u32,
    /// Number of vertices along a side of the tile.
    pub(crate) side: u32,
}

/// The destinations of a tile's data.
pub(in crate::gpu) struct HeightDestinations {
    pub(in crate::gpu) heights: LayerDestination,
    pub(in crate::gpu) table: BufferDestination,
    pub(in crate::gpu) color: LayerDestination,
}

/// The size of everything in a slot. Tiles of equal size share blocks.
#[derive(Clone, Copy, PartialEq, Eq)]
struct TileSize {
    side: u32,
    color: ImageSize,
}

impl TileSize {
    /// Returns the size of a tile, after a check that its arrays have the lengths that its side demands.
    fn of(tile: &HeightTile, limits: &wgpu::Limits, adapter: BlockFormats) -> Result<Self, String> {
        let side = tile.side;
        if !(3..=257).contains(&side) || !(side - 1).is_power_of_two() {
            return Err(format!("a height tile of {side} vertices a side; 2^k + 1 up to 257 is possible"));
        }
        let padded = (side + 2) as usize;
        for (name, got, expected) in [
            ("heights", tile.heights.len(), padded * padded),
            ("rows", tile.rows.len(), side as usize),
            ("columns", tile.columns.len(), side as usize),
        ] {
            if got != expected {
                return Err(format!("a height tile of side {side} has {got} {name} instead of {expected}"));
            }
        }
        let color = match &tile.texture {
            Some(texture) => ImageSize::of(texture, limits, adapter)?,
            None => ImageSize::ONE_TEXEL,
        };
        Ok(Self { side, color })
    }

    /// Returns the size of the heights in bytes. They have a border of one vertex.
    fn heights_bytes(&self) -> u64 {
        let padded = u64::from(self.side + 2);
        padded * padded * 4
    }

    fn bytes(&self) -> u64 {
        self.heights_bytes() + table_bytes(self.side) + self.color.bytes()
    }
}

/// The use of a layer.
#[derive(Clone, Copy, Default)]
struct Usage {
    /// Number of drawables that use the layer.
    users: u32,
    /// The key under which the tile is shared.
    content: Option<ContentKey>,
}

/// The memory of a block.
#[derive(Clone, PartialEq)]
struct HeightArrays {
    heights: wgpu::Texture,
    tables: wgpu::Buffer,
    color: wgpu::Texture,
}

impl HeightArrays {
    fn new(memory: &Memory, size: &TileSize, capacity: u32) -> Result<Self, String> {
        let padded = size.side + 2;
        let heights = wgpu::TextureDescriptor {
            label: Some("height block"),
            size: wgpu::Extent3d { width: padded, height: padded, depth_or_array_layers: capacity },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::R32Float,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        };
        let bytes = size.heights_bytes() * u64::from(capacity);
        let heights = memory.allocate("height block", bytes, |device| device.create_texture(&heights))?;
        let bytes = table_bytes(size.side) * u64::from(capacity);
        let tables = wgpu::BufferDescriptor {
            label: Some("height block tables"),
            size: bytes,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        };
        let tables = memory.allocate("height block tables", bytes, |device| device.create_buffer(&tables))?;
        let color = size.color.allocate(memory, "height block colour", capacity, TexelEncoding::Srgb)?;
        Ok(Self { heights, tables, color })
    }

    fn bind_group(&self, device: &wgpu::Device, layouts: &BindGroupLayouts) -> wgpu::BindGroup {
        let sampler = layouts.sampler(device, &Sampling::default());
        let [heights, color] = [&self.heights, &self.color].map(array_view);
        device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("height block"),
            layout: &layouts.height_block,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&heights) },
                wgpu::BindGroupEntry { binding: 1, resource: self.tables.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::TextureView(&color) },
                wgpu::BindGroupEntry { binding: 3, resource: wgpu::BindingResource::Sampler(&sampler) },
            ],
        })
    }

    /// Returns the copies to larger memory. The colour comes last.
    fn copies_to(&self, to: &Self) -> [BlockCopy; 3] {
        let layers =
            |from: &wgpu::Texture, to: &wgpu::Texture| BlockCopy::Layers { from: from.clone(), to: to.clone() };
        [
            layers(&self.heights, &to.heights),
            BlockCopy::Buffer { from: self.tables.clone(), to: to.tables.clone() },
            layers(&self.color, &to.color),
        ]
    }
}

struct HeightBlock {
    size: TileSize,
    memory: BlockMemory<HeightArrays>,
    /// Has the memory that frames read.
    bind_group: wgpu::BindGroup,
    slots: SlotAllocator,
    /// By layer.
    usage: Vec<Usage>,
}

impl HeightBlock {
    fn new(memory: &Memory, layouts: &BindGroupLayouts, size: TileSize, capacity: u32) -> Result<Self, String> {
        let arrays = HeightArrays::new(memory, &size, capacity)?;
        let bind_group = arrays.bind_group(memory.device(), layouts);
        let slots = SlotAllocator::new(capacity);
        let usage = vec![Usage::default(); capacity as usize];
        Ok(Self { size, memory: BlockMemory::new(arrays), bind_group, slots, usage })
    }

    /// Gives the block more slots. Returns the copies that must be queued before further uploads to the block.
    fn grow(&mut self, memory: &Memory, capacity: u32) -> Result<[BlockCopy; 3], String> {
        let to = HeightArrays::new(memory, &self.size, capacity)?;
        let copies = self.memory.newest().copies_to(&to);
        self.memory.grow(to);
        self.slots.grow(capacity);
        self.usage.resize(capacity as usize, Usage::default());
        Ok(copies)
    }

    /// Returns the size of all memory of the block in bytes.
    fn bytes(&self) -> u64 {
        let tiles = self.memory.all().map(|arrays| u64::from(arrays.heights.depth_or_array_layers()));
        self.size.bytes() * tiles.sum::<u64>()
    }
}

/// All height tiles of a device.
#[derive(Default)]
pub(crate) struct HeightPool {
    blocks: SlotTable<HeightBlock>,
    /// By side. Never iterated.
    grids: HashMap<u32, HeightGrid>,
    /// Slots of shared tiles. Never iterated.
    shared: HashMap<ContentKey, HeightSlot>,
    /// Copies of blocks that have grown, to be queued.
    copies: Vec<BlockCopy>,
    bytes_in_use: u64,
    bytes_allocated: u64,
}

impl HeightPool {
    /// Allocates a slot for a tile, or counts another user of the slot of an equal tile.
    pub(in crate::gpu::pools) fn allocate(
        &mut self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        tile: &HeightTile,
        content: Option<&ContentKey>,
    ) -> Result<Allocation<HeightSlot>, String> {
        if let Some(slot) = content.and_then(|key| self.shared.get(key)).copied()
            && let Some(usage) = self.usage_mut(slot)
        {
            usage.users += 1;
            return Ok(Allocation { slot, is_new: false });
        }
        let slot = self.take_slot(memory, layouts, tile)?;
        if let Some(usage) = self.usage_mut(slot) {
            *usage = Usage { users: 1, content: content.copied() };
        }
        if let Some(key) = content {
            self.shared.insert(*key, slot);
        }
        Ok(Allocation { slot, is_new: true })
    }

    fn usage_mut(&mut self, slot: HeightSlot) -> Option<&mut Usage> {
        self.blocks.get_mut(slot.block)?.usage.get_mut(slot.layer as usize)
    }

    /// Takes a free slot of the tile's size: of a block that has one, else of a block that can grow, else of a new block.
    fn take_slot(
        &mut self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        tile: &HeightTile,
    ) -> Result<HeightSlot, String> {
        let size = TileSize::of(tile, memory.limits(), memory.block_formats())?;
        let side = size.side;
        if let Entry::Vacant(grid) = self.grids.entry(side) {
            grid.insert(HeightGrid::new(memory, side)?);
        }
        let max_slots = MAX_BLOCK_TILES.min(memory.limits().max_texture_array_layers);
        let room_bytes = memory.room_bytes();
        let limits = BlockLimits { slot_bytes: size.bytes(), max_bytes: BLOCK_BYTES, max_slots, room_bytes };
        let (mut tiles_of_size, mut growable) = (0, None);
        for (index, block) in self.blocks.iter_mut().filter(|(_, block)| block.size == size) {
            tiles_of_size += block.slots.capacity();
            if let Some(layer) = block.slots.allocate() {
                self.bytes_in_use += size.bytes();
                return Ok(HeightSlot { block: index, layer, side });
            }
            growable = growable.or(limits.grown(block.slots.capacity()).map(|capacity| (index, capacity)));
        }
        if let Some((block, capacity)) = growable
            && let Some(layer) = self.grow(memory, block, capacity)
        {
            self.bytes_in_use += size.bytes();
            return Ok(HeightSlot { block, layer, side });
        }
        let mut block = HeightBlock::new(memory, layouts, size, limits.first(tiles_of_size))?;
        let layer = block.slots.allocate().ok_or("a height block without layers")?;
        self.bytes_allocated += block.bytes();
        self.bytes_in_use += size.bytes();
        Ok(HeightSlot { block: self.blocks.insert(block), layer, side })
    }

    /// Grows a block and takes one of its new slots. Returns `None` if there is no memory for that.
    fn grow(&mut self, memory: &Memory, index: u32, capacity: u32) -> Option<u32> {
        let block = self.blocks.get_mut(index)?;
        let bytes_before = block.bytes();
        let grown = block.grow(memory, capacity);
        self.bytes_allocated += block.bytes() - bytes_before;
        self.copies.extend(grown.ok()?);
        block.slots.allocate()
    }

    /// Takes the copies that must be queued before further uploads.
    pub(in crate::gpu::pools) fn take_copies(&mut self) -> impl Iterator<Item = BlockCopy> + '_ {
        self.copies.drain(..)
    }

    /// Has frames read what was copied to a colour texture and the arrays beside it.
    pub(in crate::gpu::pools) fn copied(
        &mut self,
        device: &wgpu::Device,
        layouts: &BindGroupLayouts,
        to_color: &wgpu::Texture,
    ) {
        for (_, block) in self.blocks.iter_mut() {
            let bytes_before = block.bytes();
            let memory = &mut block.memory;
            if memory.copied(|oldest| oldest.color == *to_color) {
                block.bind_group = memory.drawn().bind_group(device, layouts);
                self.bytes_allocated -= bytes_before - block.bytes();
            }
        }
    }

    /// Returns the destinations of a slot's data.
    pub(in crate::gpu) fn destinations(&self, slot: HeightSlot) -> Option<HeightDestinations> {
        let block = self.blocks.get(slot.block)?;
        let arrays = block.memory.newest().clone();
        let offset = u64::from(slot.layer) * table_bytes(slot.side);
        Some(HeightDestinations {
            heights: LayerDestination { texture: arrays.heights, layer: slot.layer },
            table: BufferDestination { buffer: arrays.tables, offset },
            color: LayerDestination { texture: arrays.color, layer: slot.layer },
        })
    }

    /// Removes one user of a slot. Frees the slot after its last user, and the block after its last slot.
    pub(in crate::gpu::pools) fn release(&mut self, slot: HeightSlot) {
        let Some(usage) = self.usage_mut(slot) else { return };
        usage.users = usage.users.saturating_sub(1);
        let Usage { users, content } = *usage;
        if users > 0 {
            return;
        }
        if let Some(key) = content.filter(|key| self.shared.get(key) == Some(&slot)) {
            self.shared.remove(&key);
        }
        if let Some(block) = self.blocks.get_mut(slot.block) {
            block.slots.release(slot.layer);
            self.bytes_in_use -= block.size.bytes();
            if block.slots.is_empty() {
                self.bytes_allocated -= block.bytes();
                self.blocks.remove(slot.block);
            }
        }
    }

    /// Returns the size of a slot in bytes.
    pub(in crate::gpu) fn slot_bytes(&self, slot: HeightSlot) -> u64 {
        self.blocks.get(slot.block).map_or(0, |block| block.size.bytes())
    }

    pub(crate) fn bind_group(&self, block: u32) -> Option<&wgpu::BindGroup> {
        self.blocks.get(block).map(|block| &block.bind_group)
    }

    /// Returns the grid of tiles of a side; `None` before the first such tile.
    pub(crate) fn grid(&self, side: u32) -> Option<&HeightGrid> {
        self.grids.get(&side)
    }

    pub(in crate::gpu::pools) fn bytes_in_use(&self) -> u64 {
        self.bytes_in_use
    }

    pub(in crate::gpu::pools) fn bytes_allocated(&self) -> u64 {
        self.bytes_allocated
    }
}
