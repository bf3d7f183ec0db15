//! The results of allocating from a pool, as the upload side uses them. Draw thread; plain values.

/// A slot for a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::gpu) struct Allocation<S> {
    pub(in crate::gpu) slot: S,
    /// True if the payload must be uploaded; false if an equal one is in the slot already.
    pub(in crate::gpu) is_new: bool,
}

/// A layer of an array texture that is uploaded to. Keeps the texture alive.
pub(in crate::gpu) struct LayerDestination {
    pub(in crate::gpu) texture: wgpu::Texture,
    pub(in crate::gpu) layer: u32,
}

/// A part of a buffer that is uploaded to. Keeps the buffer alive.
pub(in crate::gpu) struct BufferDestination {
    pub(in crate::gpu) buffer: wgpu::Buffer,
    /// Start of the part in bytes.
    pub(in crate::gpu) offset: u64,
}
