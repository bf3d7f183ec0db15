//! [`SurfacePool`]: the surfaces of all meshes of a device that have the metallic-roughness model. Draw thread.
//!
//! Surfaces whose textures lie in the same blocks of the texture pool share a set: a buffer of records and one bind
//! group. So meshes that differ in their surface alone are drawn with one bind group. Layered surfaces, which have a reflection
//! or a coat beyond the plain model, have sets of their own with larger records and more maps: others do not pay for them.

use super::surface_record::{LayeredRecord, MapLayers, SurfaceRecord};
use crate::gpu::memory::Memory;
use crate::gpu::pools::bind_group_layouts::BindGroupLayouts;
use crate::gpu::pools::slot_allocator::SlotAllocator;
use crate::gpu::pools::slot_table::SlotTable;
use crate::gpu::pools::textures::{TextureLayer, TexturePool};
use crate::scene::MetallicRoughness;

/// The number of records in the first set of some textures. Each further one has twice as many as the one before.
const MIN_RECORDS: u32 = 16;
/// The maximum number of records in a set.
const MAX_RECORDS: u32 = 4096;

/// The blocks of the base colour and of the maps. Missing maps have the block of the white texel.
type Blocks = [u32; 1 + MetallicRoughness::MAPS];

/// Returns the size of a surface in bytes, without its textures.
fn record_bytes(is_layered: bool) -> u64 {
    let size = if is_layered { size_of::<LayeredRecord>() } else { size_of::<SurfaceRecord>() };
    size as u64
}

/// The slot of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SurfaceSlot {
    pub(crate) set: u32,
    pub(crate) record: u32,
    /// True if the set is one of layered surfaces.
    pub(crate) is_layered: bool,
}

impl SurfaceSlot {
    /// Returns the size of the surface in bytes, without its textures.
    pub(in crate::gpu) fn size_bytes(self) -> u64 {
        record_bytes(self.is_layered)
    }
}

struct SurfaceSet {
    blocks: Blocks,
    /// True for layered surfaces.
    is_layered: bool,
    records: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
    slots: SlotAllocator,
    /// By record.
    maps: Vec<MapLayers>,
}

impl SurfaceSet {
    fn new(
        memory: &Memory,
        layouts: &BindGroupLayouts,
        textures: &TexturePool,
        (blocks, is_layered): (Blocks, bool),
        capacity: u32,
    ) -> Result<Self, String> {
        let size = record_bytes(is_layered) * u64::from(capacity);
        let records = wgpu::BufferDescriptor {
            label: Some("surface set"),
            size,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        };
        let records = memory.allocate("surface set", size, |device| device.create_buffer(&records))?;
        let bind_group = bind_group(memory.device(), layouts, textures, (&blocks, is_layered), &records)?;
        let maps = vec![MapLayers::default(); capacity as usize];
        Ok(Self { blocks, is_layered, records, bind_group, slots: SlotAllocator::new(capacity), maps })
    }

    fn allocated_bytes(&self) -> u64 {
        record_bytes(self.is_layered) * self.maps.len() as u64
    }
}

/// Creates the bind group of a set.
fn bind_group(
    device: &wgpu::Device,
    layouts: &BindGroupLayouts,
    textures: &TexturePool,
    (blocks, is_layered): (&Blocks, bool),
    records: &wgpu::Buffer,
) -> Result<wgpu::BindGroup, String> {
    let bound = if is_layered { blocks.len() } else { 1 + MetallicRoughness::PLAIN_MAPS };
    let views: Vec<_> = blocks[..bound].iter().map(|block| textures.view(*block)).collect();
    let mut entries = Vec::with_capacity(2 * views.len() + 1);
    for (view, binding) in views.iter().zip((0..).step_by(2)) {
        let (view, sampler) = view.as_ref().ok_or("a surface whose texture is not resident")?;
        let resource = wgpu::BindingResource::TextureView(view);
        entries.push(wgpu::BindGroupEntry { binding, resource });
        let resource = wgpu::BindingResource::Sampler(sampler);
        entries.push(wgpu::BindGroupEntry { binding: binding + 1, resource });
    }
    entries.push(wgpu::BindGroupEntry { binding: entries.len() as u32, resource: records.as_entire_binding() });
    Ok(device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("surface set"),
        layout: if is_layered { &layouts.layered_set } else { &layouts.surface_set },
        entries: &entries,
    }))
}

/// All surfaces of a device.
#[derive(Default)]
pub(crate) struct SurfacePool {
    sets: SlotTable<SurfaceSet>,
    /// The bytes of the records of surfaces.
    bytes_in_use: u64,
    /// The bytes of the records of all sets.
    bytes_allocated: u64,
}

impl SurfacePool {
    /// Allocates a slot for a surface and writes its record by the queue. `color` is the layer of the base colour, and
    /// `white` that of the white texel.
    pub(in crate::gpu::pools) fn allocate(
        &mut self,
        (memory, layouts, queue): (&Memory, &BindGroupLayouts, &wgpu::Queue),
        textures: &TexturePool,
        surface: &MetallicRoughness,
        (color, white): (TextureLayer, TextureLayer),
        maps: &MapLayers,
    ) -> Result<SurfaceSlot, String> {
        let mut blocks = [color.block; 1 + MetallicRoughness::MAPS];
        for (block, map) in blocks[1..].iter_mut().zip(maps) {
            *block = map.unwrap_or(white).block;
        }
        let slot = self.take_slot(memory, layouts, textures, (blocks, surface.is_layered()))?;
        if let Some(set) = self.sets.get_mut(slot.set) {
            set.maps[slot.record as usize] = *maps;
            let offset = slot.size_bytes() * u64::from(slot.record);
            if slot.is_layered {
                let record = LayeredRecord::new(surface, color, maps);
                queue.write_buffer(&set.records, offset, bytemuck::bytes_of(&record));
            } else {
                let record = SurfaceRecord::new(surface, color, maps);
                queue.write_buffer(&set.records, offset, bytemuck::bytes_of(&record));
            }
        }
        self.bytes_in_use += slot.size_bytes();
        Ok(slot)
    }

    /// Takes a free slot of a set with these blocks, from a new set if necessary.
    fn take_slot(
        &mut self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        textures: &TexturePool,
        (blocks, is_layered): (Blocks, bool),
    ) -> Result<SurfaceSlot, String> {
        let mut sets_of_blocks = 0;
        for (index, set) in self.sets.iter_mut() {
            if set.blocks == blocks && set.is_layered == is_layered {
                sets_of_blocks += 1;
                if let Some(record) = set.slots.allocate() {
                    return Ok(SurfaceSlot { set: index, record, is_layered });
                }
            }
        }
        let capacity = MAX_RECORDS.min(MIN_RECORDS << sets_of_blocks.min(16));
        let mut set = SurfaceSet::new(memory, layouts, textures, (blocks, is_layered), capacity)?;
        let record = set.slots.allocate().ok_or("a surface set without records")?;
        self.bytes_allocated += set.allocated_bytes();
        Ok(SurfaceSlot { set: self.sets.insert(set), record, is_layered })
    }

    /// Frees a slot, and the set after its last slot. Returns the layers of the surface's maps.
    pub(in crate::gpu::pools) fn release(&mut self, slot: SurfaceSlot) -> MapLayers {
        let Some(set) = self.sets.get_mut(slot.set) else { return MapLayers::default() };
        let maps = std::mem::take(&mut set.maps[slot.record as usize]);
        set.slots.release(slot.record);
        self.bytes_in_use -= slot.size_bytes();
        if set.slots.is_empty() {
            self.bytes_allocated -= set.allocated_bytes();
            self.sets.remove(slot.set);
        }
        maps
    }

    /// Creates the bind groups again that have a texture block which has grown.
    pub(in crate::gpu::pools) fn rebind(
        &mut self,
        (device, layouts): (&wgpu::Device, &BindGroupLayouts),
        textures: &TexturePool,
        block: u32,
    ) {
        for (_, set) in self.sets.iter_mut().filter(|(_, set)| set.blocks.contains(&block)) {
            // The blocks of a set's surfaces are resident, so that there is no error.
            if let Ok(rebound) = bind_group(device, layouts, textures, (&set.blocks, set.is_layered), &set.records) {
                set.bind_group = rebound;
            }
        }
    }

    pub(crate) fn bind_group(&self, set: u32) -> Option<&wgpu::BindGroup> {
        self.sets.get(set).map(|set| &set.bind_group)
    }

    pub(in crate::gpu::pools) fn bytes_in_use(&self) -> u64 {
        self.bytes_in_use
    }

    pub(in crate::gpu::pools) fn bytes_allocated(&self) -> u64 {
        self.bytes_allocated
    }
}
