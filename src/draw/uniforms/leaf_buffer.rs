//! The storage buffer of a frame's leaves, and how many of them it has room for. Draw thread.

use super::frame::LeafUniform;
use crate::gpu::GraphicsContext;

/// The number of leaves that the first buffer has room for.
const MIN_LEAVES: usize = 256;
const LEAF_BYTES: u64 = size_of::<LeafUniform>() as u64;

/// The buffer that shaders read leaves from.
///
/// The leaves of views have their room reserved before those of shadow casters, which use what remains.
pub(in crate::draw) struct LeafBuffer {
    /// Created for the first frame.
    buffer: Option<wgpu::Buffer>,
    /// The number of leaves in the adapter's largest buffer.
    max_leaves: usize,
    /// The number of leaves in this frame's buffer.
    room: usize,
    /// The number of leaves that may still cast shadows in this frame.
    caster_room: usize,
}

impl LeafBuffer {
    pub(in crate::draw) fn new(limits: &wgpu::Limits) -> Self {
        let max_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let max_leaves = usize::try_from(max_bytes / LEAF_BYTES).unwrap_or(usize::MAX);
        Self { buffer: None, max_leaves, room: 0, caster_room: 0 }
    }

    pub(in crate::draw) fn buffer(&self) -> Option<&wgpu::Buffer> {
        self.buffer.as_ref()
    }

    /// Returns the number of leaves that this frame has room for.
    pub(in crate::draw) fn room(&self) -> usize {
        self.room
    }

    /// Returns true if the buffer is as large as the adapter allows.
    pub(in crate::draw) fn is_largest(&self) -> bool {
        self.room == self.max_leaves
    }

    /// Makes room for a frame's own leaves and its shadow casters, as far as the adapter has memory. Returns true if
    /// the buffer was replaced, and an error if there was no memory; the old buffer stays then.
    pub(in crate::draw) fn reserve(
        &mut self,
        ctx: &GraphicsContext,
        own: usize,
        casters: usize,
    ) -> Result<bool, String> {
        let capacity = self.buffer.as_ref().map_or(0, |buffer| (buffer.size() / LEAF_BYTES) as usize);
        let wanted = own + casters;
        self.room = capacity.min(self.max_leaves);
        let is_enough = wanted.min(self.max_leaves) <= capacity && capacity > 0;
        let grown = if is_enough { Ok(false) } else { self.grow(ctx, wanted) };
        self.caster_room = self.room.saturating_sub(own);
        grown
    }

    fn grow(&mut self, ctx: &GraphicsContext, wanted: usize) -> Result<bool, String> {
        let leaves = wanted.next_power_of_two().max(MIN_LEAVES).min(self.max_leaves);
        let size = leaves as u64 * LEAF_BYTES;
        let buffer = ctx.memory().allocate("leaves", size, |device| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("leaves"),
                size,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })?;
        (self.buffer, self.room) = (Some(buffer), leaves);
        Ok(true)
    }

    /// Returns the number of leaves that may be in the buffer after the casters of one more cascade, of `used` now.
    pub(in crate::draw) fn caster_limit(&self, used: usize) -> usize {
        used + self.caster_room
    }

    /// Takes room for casters.
    pub(in crate::draw) fn take_caster_room(&mut self, count: usize) {
        self.caster_room = self.caster_room.saturating_sub(count);
    }

    /// Uploads the leaves of a frame.
    pub(in crate::draw) fn upload(&self, queue: &wgpu::Queue, leaves: &[LeafUniform]) {
        if let Some(buffer) = self.buffer.as_ref().filter(|_| !leaves.is_empty()) {
            queue.write_buffer(buffer, 0, bytemuck::cast_slice(leaves));
        }
    }

    /// Stands in for an adapter with a smaller largest buffer.
    #[cfg(test)]
    pub(in crate::draw) fn limit(&mut self, max_leaves: usize) {
        self.max_leaves = max_leaves;
    }
}
