//! Staging buffers: filled by the processor, copied from by commands that are recorded at the same time, and mapped again
//! once the adapter has executed the commands. The compile thread has some; a draw thread without one has a [`StagingPool`].
//!
//! A write by the queue itself would create a buffer, zero it and return its memory to the system each time. Staging buffers
//! are reused and stay in the core's cache.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

// The compile thread imports these two from here, so that its model test can substitute them.
pub(super) use wgpu::{Buffer, CommandBuffer, Device};

use super::Memory;
use super::resource_upload::Sink;
use crate::gpu::pools::{BlockCopy, TextureRows};

/// The size of a staging buffer of the draw thread: enough for an image of 256 x 256 texels with its levels, and a mesh.
const STAGING_BYTES: u64 = 512 << 10;
/// The number of free staging buffers that an idle draw thread keeps.
const MAX_IDLE_BUFFERS: usize = 1;

/// The states of a map request.
const IN_FLIGHT: u8 = 0;
const MAPPED: u8 = 1;
const FAILED: u8 = 2;

/// Creates a mapped staging buffer. Returns an error text if there is no memory.
pub(super) fn create_buffer(memory: &Memory, bytes: u64) -> Result<wgpu::Buffer, String> {
    let descriptor = wgpu::BufferDescriptor {
        label: Some("staging"),
        size: bytes,
        usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: true,
    };
    memory.allocate("staging buffer", bytes, |device| device.create_buffer(&descriptor))
}

/// Fills a staging buffer, and records the copies from it.
pub(super) struct StagingWriter {
    staging: wgpu::Buffer,
    view: wgpu::BufferViewMut,
    used_bytes: u64,
    encoder: wgpu::CommandEncoder,
}

/// Returns the size of a row in a staging buffer.
fn padded(row_bytes: u64) -> u64 {
    row_bytes.next_multiple_of(u64::from(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT))
}

impl Sink for StagingWriter {
    fn write_rows(&mut self, texture: &wgpu::Texture, rows: &TextureRows, data: &[u8]) {
        let row_bytes = rows.row_bytes as usize;
        let stride = padded(row_bytes as u64);
        let offset = self.used_bytes;
        if stride == row_bytes as u64 {
            self.view.slice(offset as usize..offset as usize + data.len()).copy_from_slice(data);
        } else {
            for (row, start) in data.chunks_exact(row_bytes).zip((offset as usize..).step_by(stride as usize)) {
                self.view.slice(start..start + row_bytes).copy_from_slice(row);
            }
        }
        self.used_bytes += stride * u64::from(rows.count);
        self.encoder.copy_buffer_to_texture(
            wgpu::TexelCopyBufferInfo {
                buffer: &self.staging,
                layout: wgpu::TexelCopyBufferLayout {
                    offset,
                    bytes_per_row: Some(stride as u32),
                    rows_per_image: None,
                },
            },
            rows.destination(texture),
            rows.extent(),
        );
    }

    fn write_bytes(&mut self, buffer: &wgpu::Buffer, offset: u64, data: &[u8]) {
        let start = self.used_bytes;
        self.view.slice(start as usize..start as usize + data.len()).copy_from_slice(data);
        // Rows may follow, and copies to textures have this alignment.
        self.used_bytes += padded(data.len() as u64);
        self.encoder.copy_buffer_to_buffer(&self.staging, start, buffer, offset, data.len() as u64);
    }

    fn copy_block(&mut self, copy: &BlockCopy) {
        copy.record(&mut self.encoder);
    }
}

impl StagingWriter {
    /// Begins to fill a mapped buffer. Returns `None` if it cannot be written, which means that the device is lost.
    pub(super) fn new(device: &wgpu::Device, staging: wgpu::Buffer) -> Option<Self> {
        match staging.get_mapped_range_mut(..) {
            Ok(view) => {
                let descriptor = wgpu::CommandEncoderDescriptor { label: Some("uploads") };
                let encoder = device.create_command_encoder(&descriptor);
                Some(Self { staging, view, used_bytes: 0, encoder })
            }
            Err(error) => {
                log::error!("uploads: a staging buffer cannot be written: {error}");
                None
            }
        }
    }

    /// Returns the number of units of a size that still fit.
    pub(super) fn free_units(&self, unit_bytes: usize, has_rows: bool) -> usize {
        let free_bytes = self.staging.size().saturating_sub(self.used_bytes);
        let unit_bytes = if has_rows { padded(unit_bytes as u64) } else { unit_bytes as u64 };
        (free_bytes / unit_bytes.max(1)) as usize
    }

    /// Returns the recorded copies, and the buffer that they copy from.
    pub(super) fn finish(self) -> (wgpu::CommandBuffer, wgpu::Buffer) {
        let Self { staging, view, encoder, .. } = self;
        drop(view);
        staging.unmap();
        (encoder.finish(), staging)
    }
}

/// Staging buffers that will be mapped again once the adapter has executed their commands.
#[derive(Default)]
pub(super) struct MapRequests(Vec<(wgpu::Buffer, Arc<AtomicU8>)>);

impl MapRequests {
    /// Requests that a buffer is mapped, after its commands were submitted.
    pub(super) fn request(&mut self, staging: wgpu::Buffer) {
        let state = Arc::new(AtomicU8::new(IN_FLIGHT));
        let shared_state = state.clone();
        staging.map_async(wgpu::MapMode::Write, .., move |result| {
            shared_state.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
        self.0.push((staging, state));
    }

    /// Takes the buffers that were mapped since the last call. Buffers that could not be mapped are dropped.
    pub(super) fn take_mapped(&mut self) -> impl Iterator<Item = wgpu::Buffer> + '_ {
        let state = |entry: &(_, Arc<AtomicU8>)| entry.1.load(Ordering::Acquire);
        let done = self.0.extract_if(.., move |entry| state(entry) != IN_FLIGHT);
        done.filter(move |entry| state(entry) == MAPPED).map(|(staging, _)| staging)
    }
}

/// The staging buffers of a draw thread.
#[derive(Default)]
pub(super) struct StagingPool {
    /// Mapped buffers.
    free: Vec<wgpu::Buffer>,
    requests: MapRequests,
}

impl StagingPool {
    /// Takes buffers back whose commands were submitted.
    pub(super) fn take_back(&mut self, submitted: impl Iterator<Item = wgpu::Buffer>) {
        submitted.for_each(|staging| self.requests.request(staging));
        self.free.extend(self.requests.take_mapped());
    }

    /// Begins to fill a buffer with room for at least one unit of a size. If no buffer is free, another is created, so that
    /// the draw thread never waits for one. Returns `None` if the buffer cannot be written, and an error text if there is no
    /// memory.
    pub(super) fn writer(&mut self, memory: &Memory, unit_bytes: usize) -> Result<Option<StagingWriter>, String> {
        self.free.extend(self.requests.take_mapped());
        let min_bytes = padded(unit_bytes as u64);
        let staging = match self.free.pop() {
            Some(staging) if staging.size() >= min_bytes => staging,
            _ => create_buffer(memory, min_bytes.max(STAGING_BYTES))?,
        };
        Ok(StagingWriter::new(memory.device(), staging))
    }

    /// Frees surplus buffers while there is nothing to upload.
    pub(super) fn trim(&mut self) {
        self.free.truncate(MAX_IDLE_BUFFERS);
    }
}
