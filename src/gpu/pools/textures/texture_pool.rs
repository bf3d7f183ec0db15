//! [`TexturePool`]: the textures of all meshes of a device, as layers of array textures. Draw thread.
//!
//! Images of one size, format, encoding and sampling share a block, which has one bind group. So adapters without bindless
//! textures, such as software Vulkan, draw many tiles with one bind group too. Equal images are uploaded once and share a layer
//! by reference count.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::image_size::{ImageSize, array_view};
use super::texture_rows::{TextureRows, write_rows};
use crate::gpu::memory::Memory;
use crate::gpu::pools::allocation::{Allocation, LayerDestination};
use crate::gpu::pools::bind_group_layouts::BindGroupLayouts;
use crate::gpu::pools::block_memory::{BlockCopy, BlockLimits, BlockMemory};
use crate::gpu::pools::identity::Identity;
use crate::gpu::pools::slot_allocator::SlotAllocator;
use crate::gpu::pools::slot_table::SlotTable;
use crate::gpu::pools::wgpu_enums::TexelEncoding;
use crate::scene::{ContentKey, Sampling, Texture};

/// The maximum size of a block. Larger images get blocks of one layer.
const BLOCK_BYTES: u64 = 32 << 20;
/// The maximum number of layers in a block; WebGPU guarantees 256.
const MAX_BLOCK_LAYERS: u32 = 128;

/// A layer of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TextureLayer {
    pub(crate) block: u32,
    pub(crate) layer: u32,
}

/// The use of a layer.
#[derive(Clone, Copy)]
struct Usage {
    /// Number of drawables that use the layer.
    users: u32,
    key: SharedKey,
}

/// The key under which equal images share a layer. An image may be used as colours and as numbers.
type SharedKey = (Identity, TexelEncoding);

/// The properties that the images of a block have in common.
#[derive(Clone, Copy, PartialEq, Eq)]
struct ImageKind {
    size: ImageSize,
    encoding: TexelEncoding,
    sampling: Sampling,
}

struct TextureBlock {
    kind: ImageKind,
    memory: BlockMemory<wgpu::Texture>,
    sampler: wgpu::Sampler,
    /// Has the texture that frames read.
    bind_group: wgpu::BindGroup,
    slots: SlotAllocator,
    /// By layer.
    usage: Vec<Usage>,
}

/// Creates the bind group of a block.
fn bind_group(
    device: &wgpu::Device,
    layouts: &BindGroupLayouts,
    texture: &wgpu::Texture,
    sampler: &wgpu::Sampler,
) -> wgpu::BindGroup {
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("texture block"),
        layout: &layouts.texture_block,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&array_view(texture)) },
            wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(sampler) },
        ],
    })
}

impl TextureBlock {
    fn new(memory: &Memory, layouts: &BindGroupLayouts, kind: ImageKind, capacity: u32) -> Result<Self, String> {
        let texture = kind.size.allocate(memory, "texture block", capacity, kind.encoding)?;
        let sampler = layouts.sampler(memory.device(), &kind.sampling);
        let bind_group = bind_group(memory.device(), layouts, &texture, &sampler);
        let slots = SlotAllocator::new(capacity);
        let mut block = Self { kind, memory: BlockMemory::new(texture), sampler, bind_group, slots, usage: Vec::new() };
        block.usage.resize(capacity as usize, block.unused());
        Ok(block)
    }

    fn unused(&self) -> Usage {
        Usage { users: 0, key: (Identity::Address(0), self.kind.encoding) }
    }

    /// Gives the block more layers. Returns the copy that must be queued before further uploads to the block.
    fn grow(&mut self, memory: &Memory, capacity: u32) -> Result<BlockCopy, String> {
        let to = self.kind.size.allocate(memory, "texture block", capacity, self.kind.encoding)?;
        let copy = BlockCopy::Layers { from: self.memory.newest().clone(), to: to.clone() };
        self.memory.grow(to);
        self.slots.grow(capacity);
        self.usage.resize(capacity as usize, self.unused());
        Ok(copy)
    }

    /// Returns the size of all memory of the block in bytes.
    fn bytes(&self) -> u64 {
        let layers = self.memory.all().map(|texture| u64::from(texture.depth_or_array_layers()));
        self.kind.size.bytes() * layers.sum::<u64>()
    }
}

struct SharedImage {
    /// Keeps the address from being reused for another image while the entry exists.
    image: Weak<Texture>,
    layer: TextureLayer,
}

/// All texture blocks of a device.
#[derive(Default)]
pub(crate) struct TexturePool {
    blocks: SlotTable<TextureBlock>,
    /// Never iterated.
    shared: HashMap<SharedKey, SharedImage>,
    white: Option<TextureLayer>,
    /// Copies of blocks that have grown, to be queued.
    copies: Vec<BlockCopy>,
    bytes_in_use: u64,
    bytes_allocated: u64,
}

impl TexturePool {
    /// Allocates a layer for an image, or counts another user of the layer of an equal image.
    pub(in crate::gpu::pools) fn allocate(
        &mut self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        image: &Arc<Texture>,
        encoding: TexelEncoding,
        content: Option<&ContentKey>,
    ) -> Result<Allocation<TextureLayer>, String> {
        let key = (Identity::new(content, Arc::as_ptr(image)), encoding);
        let is_same = |s: &&SharedImage| content.is_some() || std::ptr::eq(s.image.as_ptr(), Arc::as_ptr(image));
        if let Some(shared) = self.shared.get(&key).filter(is_same) {
            let slot = shared.layer;
            if let Some(usage) = self.usage_mut(slot) {
                usage.users += 1;
                return Ok(Allocation { slot, is_new: false });
            }
        }
        let size = ImageSize::of(image, memory.limits(), memory.block_formats())?;
        let slot = self.take_layer(memory, layouts, ImageKind { size, encoding, sampling: image.sampling })?;
        if let Some(usage) = self.usage_mut(slot) {
            *usage = Usage { users: 1, key };
        }
        self.shared.insert(key, SharedImage { image: Arc::downgrade(image), layer: slot });
        Ok(Allocation { slot, is_new: true })
    }

    /// Returns the layer of the white texel that drawables without a texture share. It is never freed.
    pub(in crate::gpu::pools) fn white(
        &mut self,
        memory: &Memory,
        queue: &wgpu::Queue,
        layouts: &BindGroupLayouts,
    ) -> Result<TextureLayer, String> {
        if let Some(white) = self.white {
            return Ok(white);
        }
        let (size, encoding) = (ImageSize::ONE_TEXEL, TexelEncoding::Srgb);
        let kind = ImageKind { size, encoding, sampling: Sampling::default() };
        // Its block is separate, so that no copy overwrites it.
        let white = self.take_layer_of_new_block(memory, layouts, kind, 1)?;
        if let Some(block) = self.blocks.get(white.block) {
            let texel = TextureRows { layer: white.layer, ..size.rows_of(0) };
            write_rows(queue, block.memory.newest(), &texel, &[255; 4]);
        }
        self.white = Some(white);
        Ok(white)
    }

    /// Returns the size of a layer in bytes.
    pub(in crate::gpu) fn layer_bytes(&self, layer: TextureLayer) -> u64 {
        self.blocks.get(layer.block).map_or(0, |block| block.kind.size.bytes())
    }

    fn usage_mut(&mut self, layer: TextureLayer) -> Option<&mut Usage> {
        self.blocks.get_mut(layer.block)?.usage.get_mut(layer.layer as usize)
    }

    /// Takes a free layer: of a block that has one, else of a block that can grow, else of a new block.
    fn take_layer(
        &mut self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        kind: ImageKind,
    ) -> Result<TextureLayer, String> {
        let max_slots = MAX_BLOCK_LAYERS.min(memory.limits().max_texture_array_layers);
        let room_bytes = memory.room_bytes();
        let limits = BlockLimits { slot_bytes: kind.size.bytes(), max_bytes: BLOCK_BYTES, max_slots, room_bytes };
        let (mut layers_of_kind, mut growable) = (0, None);
        let white = self.white.map(|white| white.block);
        for (index, block) in
            self.blocks.iter_mut().filter(|(index, block)| block.kind == kind && white != Some(*index))
        {
            layers_of_kind += block.slots.capacity();
            if let Some(layer) = block.slots.allocate() {
                self.bytes_in_use += limits.slot_bytes;
                return Ok(TextureLayer { block: index, layer });
            }
            growable = growable.or(limits.grown(block.slots.capacity()).map(|capacity| (index, capacity)));
        }
        if let Some((block, capacity)) = growable
            && let Some(layer) = self.grow(memory, block, capacity)
        {
            self.bytes_in_use += limits.slot_bytes;
            return Ok(TextureLayer { block, layer });
        }
        self.take_layer_of_new_block(memory, layouts, kind, limits.first(layers_of_kind))
    }

    /// Grows a block and takes one of its new layers. Returns `None` if there is no memory for that.
    fn grow(&mut self, memory: &Memory, index: u32, capacity: u32) -> Option<u32> {
        let block = self.blocks.get_mut(index)?;
        let bytes_before = block.bytes();
        let grown = block.grow(memory, capacity);
        self.bytes_allocated += block.bytes() - bytes_before;
        self.copies.push(grown.ok()?);
        block.slots.allocate()
    }

    fn take_layer_of_new_block(
        &mut self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        kind: ImageKind,
        capacity: u32,
    ) -> Result<TextureLayer, String> {
        let mut block = TextureBlock::new(memory, layouts, kind, capacity)?;
        let layer = block.slots.allocate().ok_or("a texture block without layers")?;
        self.bytes_allocated += block.bytes();
        self.bytes_in_use += kind.size.bytes();
        Ok(TextureLayer { block: self.blocks.insert(block), layer })
    }

    /// Takes the copies that must be queued before further uploads.
    pub(in crate::gpu::pools) fn take_copies(&mut self) -> impl Iterator<Item = BlockCopy> + '_ {
        self.copies.drain(..)
    }

    /// Has frames read what was copied to a texture. Returns the blocks whose textures were replaced.
    pub(in crate::gpu::pools) fn copied(
        &mut self,
        device: &wgpu::Device,
        layouts: &BindGroupLayouts,
        to: &wgpu::Texture,
    ) -> Vec<u32> {
        let mut replaced = Vec::new();
        for (index, block) in self.blocks.iter_mut() {
            let bytes_before = block.bytes();
            if !block.memory.copied(|oldest| oldest == to) {
                continue;
            }
            block.bind_group = bind_group(device, layouts, block.memory.drawn(), &block.sampler);
            self.bytes_allocated -= bytes_before - block.bytes();
            replaced.push(index);
        }
        replaced
    }

    pub(in crate::gpu) fn destination(&self, layer: TextureLayer) -> Option<LayerDestination> {
        let block = self.blocks.get(layer.block)?;
        Some(LayerDestination { texture: block.memory.newest().clone(), layer: layer.layer })
    }

    /// Removes one user of a layer. Frees the layer after its last user, and the block after its last layer.
    pub(in crate::gpu::pools) fn release(&mut self, layer: TextureLayer) {
        if Some(layer) == self.white {
            return;
        }
        let Some(usage) = self.usage_mut(layer) else { return };
        usage.users = usage.users.saturating_sub(1);
        let Usage { users, key } = *usage;
        if users > 0 {
            return;
        }
        if self.shared.get(&key).is_some_and(|s| s.layer == layer) {
            self.shared.remove(&key);
        }
        if let Some(block) = self.blocks.get_mut(layer.block) {
            block.slots.release(layer.layer);
            self.bytes_in_use -= block.kind.size.bytes();
            if block.slots.is_empty() {
                self.bytes_allocated -= block.bytes();
                self.blocks.remove(layer.block);
            }
        }
    }

    /// Returns the view of a block's images and their sampler.
    pub(in crate::gpu::pools) fn view(&self, block: u32) -> Option<(wgpu::TextureView, &wgpu::Sampler)> {
        self.blocks.get(block).map(|block| (array_view(block.memory.drawn()), &block.sampler))
    }

    pub(crate) fn bind_group(&self, block: u32) -> Option<&wgpu::BindGroup> {
        self.blocks.get(block).map(|block| &block.bind_group)
    }

    pub(in crate::gpu::pools) fn bytes_in_use(&self) -> u64 {
        self.bytes_in_use
    }

    pub(in crate::gpu::pools) fn bytes_allocated(&self) -> u64 {
        self.bytes_allocated
    }
}
