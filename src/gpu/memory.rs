//! [`Memory`]: creation of buffers and textures under an error scope, so that a failed allocation is an error of its caller
//! and everything else continues.
//!
//! The draw thread allocates while a pool grows or a frame needs another target or a larger buffer. The compile thread
//! allocates its staging buffers.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::GpuError;
use crate::scene::BlockFormats;

/// The device as an allocator. Clones share the device and the limit of tests.
#[derive(Clone)]
pub(crate) struct Memory {
    device: wgpu::Device,
    limits: wgpu::Limits,
    block_formats: BlockFormats,
    /// Bytes that may still be allocated; unlimited outside of tests. Written by the draw thread, reduced by each thread that
    /// allocates.
    left_bytes: Arc<AtomicU64>,
    /// Bytes that blocks may take before the budget is full. Of the pools' own clone.
    room_bytes: u64,
}

/// Returns the families of compressed formats of a device.
pub(super) fn block_formats(features: wgpu::Features) -> BlockFormats {
    BlockFormats {
        bc: features.contains(wgpu::Features::TEXTURE_COMPRESSION_BC),
        etc2: features.contains(wgpu::Features::TEXTURE_COMPRESSION_ETC2),
        astc: features.contains(wgpu::Features::TEXTURE_COMPRESSION_ASTC),
    }
}

impl Memory {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self {
            device: device.clone(),
            limits: device.limits(),
            block_formats: block_formats(device.features()),
            left_bytes: Arc::new(AtomicU64::new(u64::MAX)),
            room_bytes: u64::MAX,
        }
    }

    pub(crate) fn device(&self) -> &wgpu::Device {
        &self.device
    }

    pub(super) fn limits(&self) -> &wgpu::Limits {
        &self.limits
    }

    /// Returns the families of compressed formats that the device samples.
    pub(super) fn block_formats(&self) -> BlockFormats {
        self.block_formats
    }

    /// Returns the bytes that blocks may take before the budget is full.
    pub(super) fn room_bytes(&self) -> u64 {
        self.room_bytes
    }

    pub(super) fn set_room_bytes(&mut self, room_bytes: u64) {
        self.room_bytes = room_bytes;
    }

    /// Creates a buffer or texture of a size; `what` names its use in the error text.
    pub(crate) fn allocate<T>(
        &self,
        what: &'static str,
        bytes: u64,
        create: impl FnOnce(&wgpu::Device) -> T,
    ) -> Result<T, String> {
        let refused = |reason: String| GpuError::OutOfMemory { what, bytes, reason }.to_string();
        let left_bytes = self.left_bytes.load(Ordering::Relaxed);
        if bytes > left_bytes {
            return Err(refused("the limit of a test is reached".to_owned()));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let created = create(&self.device);
        // The future is ready at once: wgpu's own backends do not wait for the adapter here.
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(refused(error.to_string()));
        }
        if left_bytes < u64::MAX {
            self.left_bytes.store(left_bytes - bytes, Ordering::Relaxed);
        }
        Ok(created)
    }

    /// Creates a buffer with contents, padded to a multiple of 4 bytes.
    pub(super) fn allocate_filled(
        &self,
        what: &'static str,
        usage: wgpu::BufferUsages,
        contents: &[u8],
    ) -> Result<wgpu::Buffer, String> {
        let size = (contents.len() as u64).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
        let descriptor = wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: true };
        let buffer = self.allocate(what, size, |device| device.create_buffer(&descriptor))?;
        let mut view = buffer.get_mapped_range_mut(..).map_err(|error| format!("{what}: {error}"))?;
        view.slice(..contents.len()).copy_from_slice(contents);
        drop(view);
        buffer.unmap();
        Ok(buffer)
    }

    /// Limits the further allocations to a number of bytes; `None` removes the limit.
    #[cfg(feature = "testing")]
    pub(super) fn pretend(&self, left_bytes: Option<u64>) {
        self.left_bytes.store(left_bytes.unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}
