//! [`BlockMemory`]: the memory of a block, which is replaced by a larger one when all slots are taken. Draw thread.
//!
//! A block starts with few slots, so that a single odd image or mesh takes no more than its own size. It grows under its
//! number, so that drawables of one size still share a block. The adapter copies what it holds, in the order of the uploads:
//! earlier ones write to the old memory and are copied with it, later ones write to the new memory. Frames read the old
//! memory until the copy is recorded.

use std::collections::VecDeque;

/// The size of a block's first slots: as many as fit, from 1 to 16.
const FIRST_BYTES: u64 = 4 << 10;
const MAX_FIRST_SLOTS: u64 = 16;

/// A copy from a block's old memory to its new one, on the adapter.
#[derive(Clone, Debug)]
pub(in crate::gpu) enum BlockCopy {
    /// Copies all levels of the first layers of an array texture.
    Layers { from: wgpu::Texture, to: wgpu::Texture },
    /// Copies a whole buffer to the start of another.
    Buffer { from: wgpu::Buffer, to: wgpu::Buffer },
}

impl BlockCopy {
    /// Records the copy.
    pub(in crate::gpu) fn record(&self, encoder: &mut wgpu::CommandEncoder) {
        match self {
            Self::Layers { from, to } => {
                // wgpu-core 30 panics where the layers of a copy are in more than two states, as after uploads into some of them.
                let texture =
                    wgpu::TextureTransition { texture: from, selector: None, state: wgpu::TextureUses::COPY_SRC };
                encoder.transition_resources(std::iter::empty(), std::iter::once(texture));
                for level in 0..from.mip_level_count() {
                    let side = |side: u32| (side >> level).max(1);
                    let (block_width, block_height) = from.format().block_dimensions();
                    let size = wgpu::Extent3d {
                        width: side(from.width()).next_multiple_of(block_width),
                        height: side(from.height()).next_multiple_of(block_height),
                        depth_or_array_layers: from.depth_or_array_layers(),
                    };
                    let at = |texture| wgpu::TexelCopyTextureInfo {
                        texture,
                        mip_level: level,
                        origin: wgpu::Origin3d::ZERO,
                        aspect: wgpu::TextureAspect::All,
                    };
                    encoder.copy_texture_to_texture(at(from), at(to), size);
                }
            }
            Self::Buffer { from, to } => encoder.copy_buffer_to_buffer(from, 0, to, 0, from.size()),
        }
    }
}

/// The memory of a block: that which frames read, and larger replacements that are being filled.
#[derive(Debug)]
pub(super) struct BlockMemory<R> {
    drawn: R,
    /// Each has the contents of the one before once it is copied.
    larger: VecDeque<R>,
}

impl<R> BlockMemory<R> {
    pub(super) fn new(drawn: R) -> Self {
        Self { drawn, larger: VecDeque::new() }
    }

    /// Returns the memory that frames read.
    pub(super) fn drawn(&self) -> &R {
        &self.drawn
    }

    /// Returns the memory that uploads write to.
    pub(super) fn newest(&self) -> &R {
        self.larger.back().unwrap_or(&self.drawn)
    }

    /// Iterates over all memory of the block.
    pub(super) fn all(&self) -> impl Iterator<Item = &R> {
        std::iter::once(&self.drawn).chain(&self.larger)
    }

    /// Returns true while a copy is not recorded.
    pub(super) fn is_copying(&self) -> bool {
        !self.larger.is_empty()
    }

    /// Adds a larger replacement. The caller queues the copy of [`Self::newest`] to it before.
    pub(super) fn grow(&mut self, larger: R) {
        self.larger.push_back(larger);
    }

    /// Notes that the copies to the oldest replacements are recorded, as long as those are meant: frames read the last of
    /// them from now on. Returns true if there were any.
    pub(super) fn copied(&mut self, is_meant: impl Fn(&R) -> bool) -> bool {
        let mut is_copied = false;
        while self.larger.front().is_some_and(&is_meant)
            && let Some(copied) = self.larger.pop_front()
        {
            self.drawn = copied;
            is_copied = true;
        }
        is_copied
    }
}

/// The limits of a block's size.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockLimits {
    /// The size of a slot in bytes.
    pub(super) slot_bytes: u64,
    /// The maximum size in bytes. A block has at least one slot.
    pub(super) max_bytes: u64,
    /// The maximum number of slots.
    pub(super) max_slots: u32,
    /// The bytes that may be allocated before the budget is full. Beyond it a block has a single slot and does not grow.
    pub(super) room_bytes: u64,
}

impl BlockLimits {
    fn clamp(&self, slots: u64) -> u32 {
        let by_bytes =
            (self.max_bytes.min(self.room_bytes) / self.slot_bytes.max(1)).clamp(1, u64::from(self.max_slots.max(1)));
        slots.clamp(1, by_bytes) as u32
    }

    /// Returns the number of slots of a new block: few for the first one of a kind, and a quarter of `slots_of_kind`, those of
    /// the existing blocks, for further ones.
    pub(super) fn first(&self, slots_of_kind: u32) -> u32 {
        let first = (FIRST_BYTES / self.slot_bytes.max(1)).clamp(1, MAX_FIRST_SLOTS);
        self.clamp(first.max(u64::from(slots_of_kind) / 4))
    }

    /// Returns the number of slots after a block has grown by a half; `None` if it cannot grow.
    pub(super) fn grown(&self, slots: u32) -> Option<u32> {
        let grown = self.clamp(u64::from(slots) + u64::from(slots.div_ceil(2)));
        (grown > slots).then_some(grown)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    /// Regression: the copy panicked in wgpu when other than the first layers had been written.
    #[test]
    fn layers_are_copied_also_after_uploads_with_gaps() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let context = GraphicsContext::new_offscreen(&traits).unwrap();
        let device = context.device();
        let size = wgpu::Extent3d { width: 4, height: 4, depth_or_array_layers: 8 };
        let texture = |depth_or_array_layers| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: None,
                size: wgpu::Extent3d { depth_or_array_layers, ..size },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Rgba8Unorm,
                usage: wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::COPY_DST,
                view_formats: &[],
            })
        };
        let (from, to) = (texture(8), texture(12));
        let usage = wgpu::BufferUsages::COPY_SRC;
        let buffer =
            device.create_buffer(&wgpu::BufferDescriptor { label: None, size: 1024, usage, mapped_at_creation: false });
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for layer in [1, 3, 5, 7] {
            let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(256), rows_per_image: None };
            let origin = wgpu::Origin3d { z: layer, ..wgpu::Origin3d::ZERO };
            encoder.copy_buffer_to_texture(
                wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
                wgpu::TexelCopyTextureInfo { origin, ..from.as_image_copy() },
                wgpu::Extent3d { depth_or_array_layers: 1, ..size },
            );
        }
        BlockCopy::Layers { from, to }.record(&mut encoder);
        encoder.finish();
    }

    #[test]
    fn blocks_start_small_and_grow_by_a_half() {
        let limits = |slot_bytes| BlockLimits { slot_bytes, max_bytes: 32 << 20, max_slots: 128, room_bytes: u64::MAX };
        assert_eq!([4, 84, 1000, 4096, 1 << 20, 1 << 40].map(|bytes| limits(bytes).first(0)), [16, 16, 4, 1, 1, 1]);
        assert_eq!([0, 92, 184].map(|slots| limits(350_000).first(slots)), [1, 23, 46], "further blocks of a kind");
        let sizes = std::iter::successors(Some(1), |slots| limits(350_000).grown(*slots));
        assert_eq!(sizes.collect::<Vec<_>>(), [1, 2, 3, 5, 8, 12, 18, 27, 41, 62, 93, 95]);
        assert_eq!((limits(1 << 40).grown(1), limits(4).grown(128)), (None, None));
        let in_room = |room_bytes| BlockLimits { room_bytes, ..limits(1000) };
        assert_eq!([0, 2000, 4000].map(|room| in_room(room).first(0)), [1, 2, 4], "a block has at least one slot");
        assert_eq!([10_000, 11_000, 20_000].map(|room| in_room(room).grown(10)), [None, Some(11), Some(15)]);
    }

    #[test]
    fn frames_read_the_old_memory_until_it_is_copied() {
        let mut memory = BlockMemory::new(1);
        memory.grow(2);
        memory.grow(3);
        assert_eq!((*memory.drawn(), *memory.newest(), memory.all().sum::<i32>()), (1, 3, 6));
        assert!(!memory.copied(|to| *to == 3), "copies are recorded in order");
        assert!(memory.copied(|to| *to == 2) && !memory.copied(|to| *to == 2));
        assert_eq!((*memory.drawn(), *memory.newest()), (2, 3));
        memory.grow(4);
        assert!(memory.is_copying() && memory.copied(|_| true) && !memory.copied(|_| true));
        assert_eq!((*memory.drawn(), *memory.newest(), memory.is_copying()), (4, 4, false));
    }
}
