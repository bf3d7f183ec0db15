//! The pools that geometry and textures are uploaded to, and the table of uploaded drawables. Draw thread.
//!
//! | content | memory |
//! |---|---|
//! | height tiles, mesh textures | slots in blocks of array textures |
//! | meshes | slots in buffers of one size class each |
//! | surfaces of the metallic-roughness model | records in sets with one bind group each |
//! | Gaussian splats | a buffer or two for each cloud, and one for each view of it |
//!
//! Equal content shares a slot by reference count. A released slot is free at once, since uploads run on the same queue,
//! after the draws that used it.
//!
//! A block starts with the size of one image or mesh and grows in place (`block_memory.rs`). It is freed with its last slot.

mod allocation;
mod bind_group_layouts;
mod block_memory;
mod custom_drawables;
mod drawable_entry;
mod drawable_table;
mod heights;
mod identity;
mod meshes;
mod retire_queue;
mod slot_allocator;
mod slot_table;
mod splats;
mod surfaces;
mod textures;
mod wgpu_enums;

use std::sync::Arc;

use super::memory::Memory;
use crate::scene::{
    AttributeLayout, ContentKey, DrawSlot, HeightTile, Mesh, MetallicRoughness, SharedParts, Splats, Texture,
};
use drawable_table::DrawableTable;
use heights::HeightPool;
use splats::SplatPool;
use textures::TexturePool;

pub(super) use allocation::{Allocation, BufferDestination, LayerDestination};
pub(super) use bind_group_layouts::BindGroupLayouts;
pub(super) use block_memory::BlockCopy;
pub use custom_drawables::{CompileInfo, CustomError, TargetFormats};
pub(crate) use custom_drawables::{CustomCompile, CustomDrawables, CustomShape, MAX_COLOR_ATTACHMENTS};
#[cfg(test)]
pub(crate) use drawable_entry::LINEAR_HARMONICS;
pub(crate) use drawable_entry::{BindClass, DrawableEntry, Extent, Shape};
#[cfg(test)]
pub(crate) use heights::HEADER_VECTORS;
pub(super) use heights::{HeightSlot, table_bytes, table_words};
pub(crate) use meshes::{MAX_ATTRIBUTE_LAYOUTS, MeshPool, VertexFormat};
pub(super) use meshes::{MeshAllocation, MeshSlot, interleaved_bytes, short_index_bytes};
pub(super) use retire_queue::RetireQueue;
pub(super) use splats::SplatAllocation;
pub(crate) use splats::Viewpoint;
pub(super) use surfaces::MapLayers;
#[cfg(test)]
pub(crate) use surfaces::{LayeredRecord, SurfaceRecord};
pub(crate) use surfaces::{SurfacePool, SurfaceSlot};
pub(crate) use textures::{FallbackTextures, StateTextureBytes, StateTextures};
pub(super) use textures::{TextureLayer, TextureRows, write_rows};
pub(super) use wgpu_enums::TexelEncoding;
pub(crate) use wgpu_enums::{compare_function, texture_format, view_dimension};

/// All pools of a device, and the drawables whose data lies in them.
pub(crate) struct Pools {
    heights: HeightPool,
    meshes: MeshPool,
    textures: TexturePool,
    surfaces: SurfacePool,
    splats: SplatPool,
    customs: CustomDrawables,
    drawables: DrawableTable,
    layouts: BindGroupLayouts,
    /// Allocates blocks and chunks. Separate from the memory for frames, so that tests can limit each alone.
    memory: Memory,
    /// The budgets in bytes, by owner.
    budgets: Vec<(u16, u64)>,
}

impl Pools {
    pub(super) fn new(device: &wgpu::Device, max_anisotropy: u16) -> Self {
        Self {
            heights: HeightPool::default(),
            meshes: MeshPool::default(),
            textures: TexturePool::default(),
            surfaces: SurfacePool::default(),
            splats: SplatPool::default(),
            customs: CustomDrawables::default(),
            drawables: DrawableTable::default(),
            layouts: BindGroupLayouts::new(device, max_anisotropy),
            memory: Memory::new(device),
            budgets: Vec::new(),
        }
    }

    /// Sets the budget of an owner in bytes. Blocks do not grow ahead of need beyond the sum of all budgets; a slot that is
    /// needed is allocated all the same.
    pub(super) fn set_max_bytes(&mut self, owner: u16, max_bytes: u64) {
        self.budgets.retain(|(known, _)| *known != owner);
        self.budgets.push((owner, max_bytes));
    }

    /// Takes the budgets of the pools of a lost device.
    pub(super) fn take_budgets(&mut self, lost: &mut Self) {
        self.budgets = std::mem::take(&mut lost.budgets);
    }

    fn update_room(&mut self) {
        let sum = self.budgets.iter().fold(0u64, |sum, (_, bytes)| sum.saturating_add(*bytes));
        let max_bytes = if self.budgets.is_empty() { u64::MAX } else { sum };
        self.memory.set_room_bytes(max_bytes.saturating_sub(self.bytes_allocated()));
    }

    pub(crate) fn heights(&self) -> &HeightPool {
        &self.heights
    }

    pub(crate) fn meshes(&self) -> &MeshPool {
        &self.meshes
    }

    pub(crate) fn textures(&self) -> &TexturePool {
        &self.textures
    }

    pub(crate) fn surfaces(&self) -> &SurfacePool {
        &self.surfaces
    }

    /// Allocates the buffers of Gaussian splats.
    pub(super) fn allocate_splats(&mut self, splats: &Splats) -> Result<SplatAllocation, String> {
        self.splats.allocate(&self.memory, &self.layouts, splats)
    }

    /// Returns the bind group that draws splats from back to front for a viewpoint; `None` without it.
    pub(crate) fn sorted_splats(&self, queue: &wgpu::Queue, number: u32, from: Viewpoint) -> Option<wgpu::BindGroup> {
        self.splats.sorted(&self.memory, &self.layouts, queue, number, from)
    }

    /// Starts a draw, whose commands are submitted before the next one starts.
    pub(crate) fn start_draw(&self) {
        self.splats.start_draw();
    }

    pub(crate) fn customs(&self) -> &CustomDrawables {
        &self.customs
    }

    pub(super) fn customs_mut(&mut self) -> &mut CustomDrawables {
        &mut self.customs
    }

    pub(super) fn layouts(&self) -> &BindGroupLayouts {
        &self.layouts
    }

    /// Returns an uploaded drawable.
    pub(super) fn drawable(&self, slot: DrawSlot) -> Option<&DrawableEntry> {
        self.drawables.entry(slot)
    }

    /// Returns the bind classes by [`DrawableEntry::class`].
    pub(super) fn bind_classes(&self) -> &[BindClass] {
        self.drawables.classes()
    }

    /// Allocates a slot for a height tile; `content` is the key under which equal tiles share it.
    pub(super) fn allocate_height_tile(
        &mut self,
        tile: &HeightTile,
        content: Option<&ContentKey>,
    ) -> Result<Allocation<HeightSlot>, String> {
        self.update_room();
        self.heights.allocate(&self.memory, &self.layouts, tile, content)
    }

    /// Allocates slots for the vertices and the indices of a mesh.
    pub(super) fn allocate_mesh(
        &mut self,
        mesh: &Arc<Mesh>,
        shared: &SharedParts,
        format: VertexFormat,
    ) -> Result<MeshAllocation, String> {
        self.update_room();
        self.meshes.allocate(&self.memory, mesh, shared, format)
    }

    /// Releases a mesh that has no drawable.
    pub(super) fn release_mesh(&mut self, slot: &MeshSlot) {
        self.meshes.release(slot);
    }

    /// Allocates a layer for a mesh's texture; `content` is the key under which equal images share it.
    pub(super) fn allocate_texture(
        &mut self,
        image: &Arc<Texture>,
        encoding: TexelEncoding,
        content: Option<&ContentKey>,
    ) -> Result<Allocation<TextureLayer>, String> {
        self.update_room();
        self.textures.allocate(&self.memory, &self.layouts, image, encoding, content)
    }

    /// Releases a layer that has no drawable.
    pub(super) fn release_texture(&mut self, layer: TextureLayer) {
        self.textures.release(layer);
    }

    /// Allocates a slot for a surface whose textures are allocated. It then owns the layers of its maps.
    pub(super) fn allocate_surface(
        &mut self,
        queue: &wgpu::Queue,
        surface: &MetallicRoughness,
        color: TextureLayer,
        maps: &MapLayers,
    ) -> Result<SurfaceSlot, String> {
        let white = self.white_texture(queue)?;
        let device = (&self.memory, &self.layouts, queue);
        self.surfaces.allocate(device, &self.textures, surface, (color, white), maps)
    }

    /// Returns the white texel of meshes without a texture.
    pub(super) fn white_texture(&mut self, queue: &wgpu::Queue) -> Result<TextureLayer, String> {
        self.textures.white(&self.memory, queue, &self.layouts)
    }

    /// Returns the index of an attribute layout, see [`MeshPool::attribute_layout_index`].
    pub(super) fn attribute_layout_index(&mut self, layout: &Arc<AttributeLayout>) -> Option<u32> {
        self.meshes.attribute_layout_index(layout)
    }

    /// Adds a drawable whose slots are allocated.
    pub(super) fn insert(&mut self, entry: DrawableEntry) -> DrawSlot {
        self.drawables.insert(entry)
    }

    /// Replaces the drawable of a slot. The pools' slots of the old one are not released.
    pub(super) fn replace(&mut self, slot: DrawSlot, entry: DrawableEntry) {
        self.drawables.replace(slot, entry);
    }

    /// Removes a drawable and releases its slots.
    pub(super) fn release(&mut self, slot: DrawSlot) {
        let Some(entry) = self.drawables.remove(slot) else { return };
        match &entry.shape {
            Shape::Height(slot) => self.heights.release(*slot),
            Shape::Mesh { slot, texture, surface, .. } => {
                self.meshes.release(slot);
                let maps = surface.map(|surface| self.surfaces.release(surface));
                maps.into_iter().flatten().flatten().for_each(|map| self.textures.release(map));
                self.textures.release(*texture);
            }
            Shape::Splats { number, .. } => self.splats.release(*number),
            Shape::Custom(index) => self.customs.release(*index),
        }
    }

    /// Takes the copies of blocks that have grown. They must be queued before the uploads to slots allocated since.
    pub(super) fn take_copies(&mut self) -> impl Iterator<Item = BlockCopy> + '_ {
        let Self { heights, meshes, textures, .. } = self;
        heights.take_copies().chain(meshes.take_copies()).chain(textures.take_copies())
    }

    /// Returns true while a copy of meshes is not recorded, so that writes by the queue would be overwritten.
    pub(super) fn is_copying_meshes(&mut self) -> bool {
        self.meshes.is_copying()
    }

    /// Notes that a copy is recorded, and that the next frame is submitted after it: frames read the new memory from now on.
    pub(super) fn copied(&mut self, copy: &BlockCopy) {
        let Self { heights, meshes, textures, surfaces, layouts, memory, .. } = self;
        let device = memory.device();
        match copy {
            BlockCopy::Layers { to, .. } => {
                heights.copied(device, layouts, to);
                for block in textures.copied(device, layouts, to) {
                    surfaces.rebind((device, layouts), textures, block);
                }
            }
            BlockCopy::Buffer { to, .. } => meshes.copied(Some(to)),
        }
    }

    /// Notes that all copies of meshes are recorded.
    pub(super) fn meshes_copied(&mut self) {
        self.meshes.copied(None);
    }

    /// Returns the size of all slots in use.
    pub(super) fn bytes_in_use(&self) -> u64 {
        self.heights.bytes_in_use()
            + self.meshes.bytes_in_use()
            + self.textures.bytes_in_use()
            + self.surfaces.bytes_in_use()
            + self.splats.bytes()
            + self.customs.bytes()
    }

    /// Returns the size of all blocks and chunks, free slots included.
    pub(super) fn bytes_allocated(&self) -> u64 {
        self.heights.bytes_allocated()
            + self.meshes.bytes_allocated()
            + self.textures.bytes_allocated()
            + self.surfaces.bytes_allocated()
            + self.splats.bytes()
            + self.customs.bytes()
    }

    /// Limits the further growth of the pools to a number of bytes; `None` removes the limit.
    #[cfg(feature = "testing")]
    pub(super) fn pretend_memory(&self, left_bytes: Option<u64>) {
        self.memory.pretend(left_bytes);
    }
}
