//! Textures of meshes: layers of 2D array textures, one block per size, equal images uploaded once.
//!
//! Draw thread only. Adapters without bindless textures (software Vulkan among them) still draw many tiles
//! with one bind group this way.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::layouts::Layouts;
use super::memory::Memory;
use super::slots::{Identity, SlotAllocator, block_capacity};
use super::table::Table;
use super::uploads::{Destination, QueueSink, Source, Upload};
use crate::scene::{ContentKey, Texture};
use crate::state::{CLAMPED, WrapMode};

/// Bytes a block aims at; larger images get blocks of one layer.
const BLOCK_BYTES: u64 = 32 << 20;
/// Most layers in a block; 256 is WebGPU's guaranteed limit.
const BLOCK_LAYERS: u32 = 128;

/// Size of an image with its mips: images of one size share blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ImageSize {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) mips: u32,
}

impl ImageSize {
    /// The size of a texture, after checking that its levels hold what they should.
    pub(super) fn of(texture: &Texture, limits: &wgpu::Limits) -> Result<Self, String> {
        let (width, height) = (texture.width, texture.height);
        let limit = limits.max_texture_dimension_2d;
        if width == 0 || height == 0 || width > limit || height > limit {
            return Err(format!("a texture of {width}x{height} texels is not possible (1 to {limit} a side)"));
        }
        let full = 32 - width.max(height).leading_zeros();
        let mips = texture.mips.len();
        if mips == 0 || mips > full as usize {
            return Err(format!("a texture of {width}x{height} texels has {mips} levels (1 to {full})"));
        }
        let size = Self { width, height, mips: mips as u32 };
        for (level, data) in (0u32..).zip(&texture.mips) {
            let [w, h] = size.level(level);
            let expected = w as usize * h as usize * 4;
            if data.len() != expected {
                return Err(format!("level {level} of a texture has {} bytes instead of {expected}", data.len()));
            }
        }
        Ok(size)
    }

    pub(super) fn level(&self, level: u32) -> [u32; 2] {
        [(self.width >> level).max(1), (self.height >> level).max(1)]
    }

    pub(super) fn bytes(&self) -> u64 {
        (0..self.mips).map(|l| self.level(l).map(u64::from).iter().product::<u64>() * 4).sum()
    }

    /// As [`Self::create`] does, where there is memory for it.
    pub(super) fn make(&self, memory: &mut Memory, label: &'static str, layers: u32) -> Result<wgpu::Texture, String> {
        memory.make(label, self.bytes() * u64::from(layers), |device| self.create(device, label, layers))
    }

    pub(super) fn create(&self, device: &wgpu::Device, label: &str, layers: u32) -> wgpu::Texture {
        device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d { width: self.width, height: self.height, depth_or_array_layers: layers },
            mip_level_count: self.mips,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8UnormSrgb,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        })
    }
}

/// The view of all layers that blocks bind.
pub(super) fn array_view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}

/// Rows of one level of one layer.
pub(super) struct Rows {
    pub(super) layer: u32,
    pub(super) level: u32,
    pub(super) first: u32,
    pub(super) count: u32,
    pub(super) width: u32,
}

/// Writes some rows; `data` holds exactly these, 4 bytes a texel.
pub(super) fn write_rows(queue: &wgpu::Queue, texture: &wgpu::Texture, rows: &Rows, data: &[u8]) {
    queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: rows.level,
            origin: wgpu::Origin3d { x: 0, y: rows.first, z: rows.layer },
            aspect: wgpu::TextureAspect::All,
        },
        data,
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(rows.width * 4), rows_per_image: None },
        wgpu::Extent3d { width: rows.width, height: rows.count, depth_or_array_layers: 1 },
    );
}

/// A layer of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TextureLayer {
    pub(crate) block: u32,
    pub(crate) layer: u32,
}

struct Block {
    size: ImageSize,
    wrap: [WrapMode; 2],
    texture: wgpu::Texture,
    bind_group: wgpu::BindGroup,
    slots: SlotAllocator,
    capacity: u32,
    /// Per layer: number of drawables that use it, and what it is shared as.
    users: Vec<(u32, Identity)>,
}

struct Shared {
    /// Keeps the address from being used for another image while the entry stands.
    image: Weak<Texture>,
    place: TextureLayer,
}

/// All texture blocks of a context.
#[derive(Default)]
pub(crate) struct TexturePool {
    blocks: Table<Block>,
    /// Only looked up, never walked.
    shared: HashMap<Identity, Shared>,
    white: Option<TextureLayer>,
    bytes_in_use: u64,
    bytes_allocated: u64,
}

impl TexturePool {
    /// A layer for an image; true when it must be uploaded, false when it is there already.
    pub(super) fn allocate(
        &mut self,
        memory: &mut Memory,
        layouts: &Layouts,
        image: &Arc<Texture>,
        content: Option<&ContentKey>,
    ) -> Result<(TextureLayer, bool), String> {
        let key = Identity::new(content, Arc::as_ptr(image));
        let is_same = |s: &&Shared| content.is_some() || std::ptr::eq(s.image.as_ptr(), Arc::as_ptr(image));
        if let Some(shared) = self.shared.get(&key).filter(is_same) {
            let place = shared.place;
            if let Some(user) = self.user_mut(place) {
                user.0 += 1;
                return Ok((place, false));
            }
        }
        let size = ImageSize::of(image, &memory.limits)?;
        let place = self.take_place(memory, layouts, size, image.wrap)?;
        if let Some(user) = self.user_mut(place) {
            *user = (1, key);
        }
        self.shared.insert(key, Shared { image: Arc::downgrade(image), place });
        Ok((place, true))
    }

    /// The single white texel for drawables without a texture.
    pub(super) fn white(
        &mut self,
        memory: &mut Memory,
        queue: &wgpu::Queue,
        layouts: &Layouts,
    ) -> Result<TextureLayer, String> {
        if let Some(place) = self.white {
            return Ok(place);
        }
        let size = ImageSize { width: 1, height: 1, mips: 1 };
        let place = self.take_place(memory, layouts, size, CLAMPED)?;
        if let Some(into) = self.destination(place) {
            Upload::new(Source::White, into).write(&mut QueueSink(queue), &mut Vec::new(), 1);
        }
        self.white = Some(place);
        Ok(place)
    }

    pub(super) fn bytes_of(&self, place: TextureLayer) -> u64 {
        self.blocks.get(place.block).map_or(0, |block| block.size.bytes())
    }

    fn user_mut(&mut self, place: TextureLayer) -> Option<&mut (u32, Identity)> {
        self.blocks.get_mut(place.block)?.users.get_mut(place.layer as usize)
    }

    fn take_place(
        &mut self,
        memory: &mut Memory,
        layouts: &Layouts,
        size: ImageSize,
        wrap: [WrapMode; 2],
    ) -> Result<TextureLayer, String> {
        let mut like = 0;
        for (index, block) in self.blocks.iter_mut() {
            if block.size == size && block.wrap == wrap {
                like += 1;
                if let Some(layer) = block.slots.allocate() {
                    self.bytes_in_use += size.bytes();
                    return Ok(TextureLayer { block: index, layer });
                }
            }
        }
        let most = BLOCK_LAYERS.min(memory.limits.max_texture_array_layers);
        let capacity = block_capacity(like, size.bytes(), BLOCK_BYTES, most);
        let texture = size.make(memory, "texture block", capacity)?;
        let bind_group = memory.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("texture block"),
            layout: &layouts.texture_block,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&array_view(&texture)),
                },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(layouts.wrapping(wrap)) },
            ],
        });
        let mut slots = SlotAllocator::new(capacity);
        let layer = slots.allocate().ok_or("a texture block without layers")?;
        let users = vec![(0, Identity::Address(0)); capacity as usize];
        let block = Block { size, wrap, texture, bind_group, slots, capacity, users };
        self.bytes_allocated += size.bytes() * u64::from(capacity);
        self.bytes_in_use += size.bytes();
        let block = self.blocks.insert(block);
        Ok(TextureLayer { block, layer })
    }

    pub(super) fn destination(&self, place: TextureLayer) -> Option<Destination> {
        let block = self.blocks.get(place.block)?;
        Some(Destination::Layer(block.texture.clone(), place.layer))
    }

    /// One drawable fewer uses the layer; it is free when none does.
    pub(super) fn release(&mut self, place: TextureLayer) {
        if Some(place) == self.white {
            return;
        }
        let Some(user) = self.user_mut(place) else { return };
        user.0 = user.0.saturating_sub(1);
        let (count, key) = *user;
        if count > 0 {
            return;
        }
        if self.shared.get(&key).is_some_and(|s| s.place == place) {
            self.shared.remove(&key);
        }
        if let Some(block) = self.blocks.get_mut(place.block) {
            block.slots.release(place.layer);
            self.bytes_in_use -= block.size.bytes();
            if block.slots.is_empty() {
                self.bytes_allocated -= block.size.bytes() * u64::from(block.capacity);
                self.blocks.remove(place.block);
            }
        }
    }

    pub(crate) fn bind_group(&self, block: u32) -> Option<&wgpu::BindGroup> {
        self.blocks.get(block).map(|b| &b.bind_group)
    }

    pub(super) fn bytes_in_use(&self) -> u64 {
        self.bytes_in_use
    }

    pub(super) fn bytes_allocated(&self) -> u64 {
        self.bytes_allocated
    }
}
