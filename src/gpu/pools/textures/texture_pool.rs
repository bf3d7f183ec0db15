//! [`TexturePool`]: the textures of all meshes of a device, as layers of array textures. Draw thread.
//!
//! Images of one size, format, encoding and sampling share a block, which has one bind group. So adapters without bindless textures, such as
//! software Vulkan, draw many tiles with one bind group too. Equal images are uploaded once and share a layer by reference
//! count.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::image_size::{ImageSize, array_view};
use super::texture_rows::{TextureRows, write_rows};
use super::wgpu_enums::TexelEncoding;
use crate::gpu::memory::Memory;
use crate::gpu::pools::allocation::{Allocation, LayerDestination};
use crate::gpu::pools::bind_group_layouts::BindGroupLayouts;
use crate::gpu::pools::identity::Identity;
use crate::gpu::pools::slot_allocator::{SlotAllocator, block_capacity};
use crate::gpu::pools::slot_table::SlotTable;
use crate::scene::{ContentKey, Sampling, Texture};

/// The target size of a block. Larger images get blocks of one layer.
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
    texture: wgpu::Texture,
    sampler: wgpu::Sampler,
    bind_group: wgpu::BindGroup,
    slots: SlotAllocator,
    /// By layer.
    usage: Vec<Usage>,
}

impl TextureBlock {
    fn new(memory: &Memory, layouts: &BindGroupLayouts, kind: ImageKind, capacity: u32) -> Result<Self, String> {
        let texture = kind.size.allocate(memory, "texture block", capacity, kind.encoding)?;
        let sampler = layouts.sampler(memory.device(), &kind.sampling);
        let bind_group = memory.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("texture block"),
            layout: &layouts.texture_block,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&array_view(&texture)),
                },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&sampler) },
            ],
        });
        let slots = SlotAllocator::new(capacity);
        let usage = vec![Usage { users: 0, key: (Identity::Address(0), kind.encoding) }; capacity as usize];
        Ok(Self { kind, texture, sampler, bind_group, slots, usage })
    }

    /// Returns the size of the whole block in bytes.
    fn bytes(&self) -> u64 {
        self.kind.size.bytes() * self.usage.len() as u64
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
        let white = self.take_layer(memory, layouts, kind)?;
        if let Some(block) = self.blocks.get(white.block) {
            let texel = TextureRows { layer: white.layer, ..size.rows_of(0) };
            write_rows(queue, &block.texture, &texel, &[255; 4]);
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

    /// Takes a free layer, from a new block if necessary.
    fn take_layer(
        &mut self,
        memory: &Memory,
        layouts: &BindGroupLayouts,
        kind: ImageKind,
    ) -> Result<TextureLayer, String> {
        let bytes = kind.size.bytes();
        let mut blocks_of_kind = 0;
        for (index, block) in self.blocks.iter_mut() {
            if block.kind == kind {
                blocks_of_kind += 1;
                if let Some(layer) = block.slots.allocate() {
                    self.bytes_in_use += bytes;
                    return Ok(TextureLayer { block: index, layer });
                }
            }
        }
        let max_layers = MAX_BLOCK_LAYERS.min(memory.limits().max_texture_array_layers);
        let capacity = block_capacity(blocks_of_kind, bytes, BLOCK_BYTES, max_layers);
        let mut block = TextureBlock::new(memory, layouts, kind, capacity)?;
        let layer = block.slots.allocate().ok_or("a texture block without layers")?;
        self.bytes_allocated += block.bytes();
        self.bytes_in_use += bytes;
        let block = self.blocks.insert(block);
        Ok(TextureLayer { block, layer })
    }

    pub(in crate::gpu) fn destination(&self, layer: TextureLayer) -> Option<LayerDestination> {
        let block = self.blocks.get(layer.block)?;
        Some(LayerDestination { texture: block.texture.clone(), layer: layer.layer })
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
        self.blocks.get(block).map(|block| (array_view(&block.texture), &block.sampler))
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
