//! The adapter's memory that pools grow by. Asked for under an error scope: where there is none the drawable that needed
//! it cannot be made, and all else goes on. Draw thread only, and only while a pool grows.

use super::GpuError;

/// The device, as pools know it.
pub(super) struct Memory {
    device: wgpu::Device,
    pub(super) limits: wgpu::Limits,
    /// Bytes that may still be made; without end but in tests of what comes after.
    left_bytes: u64,
}

impl Memory {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self { device: device.clone(), limits: device.limits(), left_bytes: u64::MAX }
    }

    pub(super) fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// Makes what takes so many bytes; else says what could not be made.
    pub(super) fn make<T>(
        &mut self,
        what: &'static str,
        bytes: u64,
        make: impl FnOnce(&wgpu::Device) -> T,
    ) -> Result<T, String> {
        let refused = |reason: String| GpuError::OutOfMemory { what, bytes, reason }.to_string();
        if bytes > self.left_bytes {
            return Err(refused("as a test has it".to_owned()));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let made = make(&self.device);
        // Known at once: wgpu's own backends do not wait for the adapter here.
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(refused(error.to_string()));
        }
        if self.left_bytes < u64::MAX {
            self.left_bytes -= bytes;
        }
        Ok(made)
    }

    /// Makes a buffer that holds something.
    pub(super) fn make_filled(
        &mut self,
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
    pub(super) fn pretend(&mut self, left_bytes: Option<u64>) {
        self.left_bytes = left_bytes.unwrap_or(u64::MAX);
    }
}
