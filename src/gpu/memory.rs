//! The adapter's memory. Asked for under an error scope: where there is none, what needed it cannot be made, and all else
//! goes on. The draw thread asks while a pool grows or a frame needs another target or a larger buffer, the compile
//! thread for its staging buffers.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::GpuError;

/// The device, as those know it that ask for memory. Clones have the same.
#[derive(Clone)]
pub(crate) struct Memory {
    device: wgpu::Device,
    pub(super) limits: wgpu::Limits,
    /// Bytes that may still be made; without end but in tests of what comes after. Written by the draw thread, taken from
    /// by whoever asks.
    left_bytes: Arc<AtomicU64>,
}

impl Memory {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self { device: device.clone(), limits: device.limits(), left_bytes: Arc::new(AtomicU64::new(u64::MAX)) }
    }

    pub(crate) fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// Makes what takes so many bytes; else says what could not be made.
    pub(crate) fn make<T>(
        &self,
        what: &'static str,
        bytes: u64,
        make: impl FnOnce(&wgpu::Device) -> T,
    ) -> Result<T, String> {
        let refused = |reason: String| GpuError::OutOfMemory { what, bytes, reason }.to_string();
        let left_bytes = self.left_bytes.load(Ordering::Relaxed);
        if bytes > left_bytes {
            return Err(refused("as a test has it".to_owned()));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let made = make(&self.device);
        // Known at once: wgpu's own backends do not wait for the adapter here.
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(refused(error.to_string()));
        }
        if left_bytes < u64::MAX {
            self.left_bytes.store(left_bytes - bytes, Ordering::Relaxed);
        }
        Ok(made)
    }

    /// Makes a buffer that holds something.
    pub(super) fn make_filled(
        &self,
        what: &'static str,
        usage: wgpu::BufferUsages,
        contents: &[u8],
    ) -> Result<wgpu::Buffer, String> {
        let size = (contents.len() as u64).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
        let descriptor = wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: true };
        let buffer = self.make(what, size, |device| device.create_buffer(&descriptor))?;
        let mut view = buffer.get_mapped_range_mut(..).map_err(|error| format!("{what}: {error}"))?;
        view.slice(..contents.len()).copy_from_slice(contents);
        drop(view);
        buffer.unmap();
        Ok(buffer)
    }

    /// Lets no more than so many further bytes be made; `None`: as many as there are.
    #[cfg(feature = "testing")]
    pub(super) fn pretend(&self, left_bytes: Option<u64>) {
        self.left_bytes.store(left_bytes.unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}
