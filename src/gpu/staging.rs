//! Staging buffers: filled by the processor, copied from by commands that are recorded beside it, mapped again once these
//! have run. The compile thread has some, and the draw thread of a context without one.
//!
//! A write by the queue itself makes a buffer for each, zeroes it and gives it back to the system; these are used again and
//! stay in the core's cache.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

// What the compile thread names of wgpu; model tests put others in their place.
pub(super) use wgpu::{Buffer, CommandBuffer};

use super::memory::Memory;
use super::texture_pool::Rows;
use super::uploads::Sink;

/// Bytes of a buffer of the draw thread: an image of 256 x 256 texels with its levels, and a mesh.
const STAGING_BYTES: u64 = 512 << 10;
/// Those that are kept while there is nothing to do.
const KEPT: usize = 1;

const IN_FLIGHT: u8 = 0;
const MAPPED: u8 = 1;
const FAILED: u8 = 2;

/// A new staging buffer, mapped; why there is none.
pub(super) fn make(memory: &Memory, bytes: u64) -> Result<wgpu::Buffer, String> {
    let descriptor = wgpu::BufferDescriptor {
        label: Some("staging"),
        size: bytes,
        usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: true,
    };
    memory.make("staging buffer", bytes, |device| device.create_buffer(&descriptor))
}

/// A staging buffer that is being filled.
pub(super) struct Filling {
    staging: wgpu::Buffer,
    view: wgpu::BufferViewMut,
    used: u64,
    encoder: wgpu::CommandEncoder,
}

/// What a row takes in a staging buffer.
fn padded(row_bytes: u64) -> u64 {
    row_bytes.next_multiple_of(u64::from(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT))
}

impl Sink for Filling {
    fn write_rows(&mut self, texture: &wgpu::Texture, rows: &Rows, data: &[u8]) {
        let row_bytes = rows.width as usize * 4;
        let stride = padded(row_bytes as u64);
        let offset = self.used;
        if stride == row_bytes as u64 {
            self.view.slice(offset as usize..offset as usize + data.len()).copy_from_slice(data);
        } else {
            for (row, place) in data.chunks_exact(row_bytes).zip((offset as usize..).step_by(stride as usize)) {
                self.view.slice(place..place + row_bytes).copy_from_slice(row);
            }
        }
        self.used += stride * u64::from(rows.count);
        self.encoder.copy_buffer_to_texture(
            wgpu::TexelCopyBufferInfo {
                buffer: &self.staging,
                layout: wgpu::TexelCopyBufferLayout {
                    offset,
                    bytes_per_row: Some(stride as u32),
                    rows_per_image: None,
                },
            },
            wgpu::TexelCopyTextureInfo {
                texture,
                mip_level: rows.level,
                origin: wgpu::Origin3d { x: 0, y: rows.first, z: rows.layer },
                aspect: wgpu::TextureAspect::All,
            },
            wgpu::Extent3d { width: rows.width, height: rows.count, depth_or_array_layers: 1 },
        );
    }

    fn write_bytes(&mut self, buffer: &wgpu::Buffer, offset: u64, data: &[u8]) {
        let from = self.used;
        self.view.slice(from as usize..from as usize + data.len()).copy_from_slice(data);
        // Rows that follow begin where textures may be copied from.
        self.used += padded(data.len() as u64);
        self.encoder.copy_buffer_to_buffer(&self.staging, from, buffer, offset, data.len() as u64);
    }
}

impl Filling {
    /// Begins to fill a mapped buffer; `None` where it cannot be written.
    pub(super) fn new(device: &wgpu::Device, staging: wgpu::Buffer) -> Option<Self> {
        match staging.get_mapped_range_mut(..) {
            Ok(view) => {
                let descriptor = wgpu::CommandEncoderDescriptor { label: Some("uploads") };
                let encoder = device.create_command_encoder(&descriptor);
                Some(Self { staging, view, used: 0, encoder })
            }
            Err(error) => {
                // The device is lost; who draws finds out.
                log::error!("uploads: a staging buffer cannot be written: {error}");
                None
            }
        }
    }

    /// Units of so many bytes that still fit.
    pub(super) fn room(&self, unit_bytes: usize, has_rows: bool) -> usize {
        let left = self.staging.size().saturating_sub(self.used);
        let unit_bytes = if has_rows { padded(unit_bytes as u64) } else { unit_bytes as u64 };
        (left / unit_bytes.max(1)) as usize
    }

    /// The commands that copy, and the buffer that they copy from.
    pub(super) fn finish(self) -> (wgpu::CommandBuffer, wgpu::Buffer) {
        let Self { staging, view, encoder, .. } = self;
        drop(view);
        staging.unmap();
        (encoder.finish(), staging)
    }
}

/// Buffers whose commands were submitted, asked to be mapped.
#[derive(Default)]
pub(super) struct Mapping(Vec<(wgpu::Buffer, Arc<AtomicU8>)>);

impl Mapping {
    /// Asks for a buffer to be mapped again, after its commands were submitted.
    pub(super) fn ask(&mut self, staging: wgpu::Buffer) {
        let state = Arc::new(AtomicU8::new(IN_FLIGHT));
        let mapped = state.clone();
        staging.map_async(wgpu::MapMode::Write, .., move |result| {
            mapped.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
        self.0.push((staging, state));
    }

    /// Those that were mapped since.
    pub(super) fn mapped(&mut self) -> impl Iterator<Item = wgpu::Buffer> + '_ {
        let state = |entry: &(_, Arc<AtomicU8>)| entry.1.load(Ordering::Acquire);
        let done = self.0.extract_if(.., move |entry| state(entry) != IN_FLIGHT);
        done.filter(move |entry| state(entry) == MAPPED).map(|(staging, _)| staging)
    }
}

/// The buffers of a draw thread.
#[derive(Default)]
pub(super) struct Stagings {
    /// Mapped.
    free: Vec<wgpu::Buffer>,
    mapping: Mapping,
}

impl Stagings {
    /// Gives buffers back whose commands were submitted.
    pub(super) fn submitted(&mut self, stagings: &mut Vec<wgpu::Buffer>) {
        stagings.drain(..).for_each(|staging| self.mapping.ask(staging));
        self.free.extend(self.mapping.mapped());
    }

    /// A buffer to fill, for units of so many bytes. As many are made as are on their way: nobody waits for one. `None`
    /// where it cannot be written; why none can be made.
    pub(super) fn fill(&mut self, memory: &Memory, unit_bytes: usize) -> Result<Option<Filling>, String> {
        self.free.extend(self.mapping.mapped());
        let least = padded(unit_bytes as u64);
        let staging = match self.free.pop() {
            Some(staging) if staging.size() >= least => staging,
            _ => make(memory, least.max(STAGING_BYTES))?,
        };
        Ok(Filling::new(memory.device(), staging))
    }

    /// Frees what is too much while nothing is to be done.
    pub(super) fn trim(&mut self) {
        self.free.truncate(KEPT);
    }
}
