//! [`Upload`]: one resource to upload, with its progress, whichever thread uploads it. Draw thread, or the compile thread
//! of a context that has one.

use std::sync::Arc;

use crate::gpu::pools::{
    BlockCopy, BufferDestination, LayerDestination, TextureRows, VertexFormat, interleaved_bytes, short_index_bytes,
    table_bytes, table_words, write_rows,
};
use crate::scene::{HeightTile, Mesh, Splat, Splats, TexelFormat, Texture, added_stride};
use crate::state::TextureObject;

/// The means by which bytes reach the adapter.
pub(super) trait Sink {
    /// Writes whole rows of a texture; `data` holds exactly these rows.
    fn write_rows(&mut self, texture: &wgpu::Texture, rows: &TextureRows, data: &[u8]);

    /// Writes a part of a buffer. `data` is a multiple of four bytes.
    fn write_bytes(&mut self, buffer: &wgpu::Buffer, offset: u64, data: &[u8]);

    /// Copies the contents of a block that has grown, after everything written before.
    fn copy_block(&mut self, copy: &BlockCopy);
}

/// Writes by the queue. Only the thread that submits may use it.
pub(super) struct QueueSink<'a> {
    pub(super) device: &'a wgpu::Device,
    pub(super) queue: &'a wgpu::Queue,
}

impl Sink for QueueSink<'_> {
    fn write_rows(&mut self, texture: &wgpu::Texture, rows: &TextureRows, data: &[u8]) {
        write_rows(self.queue, texture, rows, data);
    }

    fn write_bytes(&mut self, buffer: &wgpu::Buffer, offset: u64, data: &[u8]) {
        self.queue.write_buffer(buffer, offset, data);
    }

    fn copy_block(&mut self, copy: &BlockCopy) {
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("block copy") };
        let mut encoder = self.device.create_command_encoder(&descriptor);
        copy.record(&mut encoder);
        self.queue.submit([encoder.finish()]);
    }
}

/// The texels of a texture's layer.
pub(super) enum ImageSource {
    Heights(Arc<HeightTile>),
    Image(Arc<Texture>),
    /// A single white texel.
    White,
}

/// The contents of a part of a buffer.
pub(super) enum BufferSource {
    HeightTable(Arc<HeightTile>),
    Vertices(Arc<Mesh>, VertexFormat),
    /// Indices of 32 bits.
    Indices(Arc<Mesh>),
    /// Indices of 16 bits, two per unit.
    ShortIndices(Arc<Mesh>),
    Splats(Arc<Splats>),
    /// The harmonics of splats.
    SplatHarmonics(Arc<Splats>),
}

enum Resource {
    Layer(ImageSource, LayerDestination),
    Buffer(BufferSource, BufferDestination),
    /// A texture of state sets.
    State(Arc<TextureObject>, wgpu::Texture),
    /// A copy on the adapter. It uploads nothing and counts as one unit of no bytes.
    Copy(BlockCopy),
}

/// A number of rows, vertices, indices or splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Units {
    pub(super) count: usize,
    /// The size of one in bytes.
    pub(super) unit_bytes: usize,
}

/// A resource to upload, with its progress.
pub(super) struct Upload {
    resource: Resource,
    /// The current level of an image, or layer of a level of a texture of state sets; 0 for buffers.
    level: u32,
    /// The number of uploaded units of the current level.
    done: usize,
}

impl Upload {
    pub(super) fn to_layer(source: ImageSource, destination: LayerDestination) -> Self {
        Self { resource: Resource::Layer(source, destination), level: 0, done: 0 }
    }

    pub(super) fn to_buffer(source: BufferSource, destination: BufferDestination) -> Self {
        Self { resource: Resource::Buffer(source, destination), level: 0, done: 0 }
    }

    pub(super) fn to_state_texture(object: Arc<TextureObject>, texture: wgpu::Texture) -> Self {
        Self { resource: Resource::State(object, texture), level: 0, done: 0 }
    }

    pub(super) fn copy(copy: BlockCopy) -> Self {
        Self { resource: Resource::Copy(copy), level: 0, done: 0 }
    }

    /// Returns the units of a level; `None` beyond the last one. A level has at least one unit, since the pools refuse empty
    /// meshes and images.
    fn units(&self, level: u32) -> Option<Units> {
        match &self.resource {
            Resource::Layer(source, _) => source.rows(level),
            Resource::Buffer(source, _) => (level == 0).then(|| source.units()),
            Resource::State(object, _) => {
                let (level, _) = layer_of(object, level)?;
                let [width, height, _] = object.level_size(level);
                Some(Units { count: height as usize, unit_bytes: width as usize * object.format.texel_bytes() })
            }
            Resource::Copy(_) => (level == 0).then_some(Units { count: 1, unit_bytes: 0 }),
        }
    }

    /// Returns the remaining units of the current level; `None` when the upload is complete.
    pub(super) fn remaining(&self) -> Option<Units> {
        let Units { count, unit_bytes } = self.units(self.level)?;
        Some(Units { count: count - self.done, unit_bytes })
    }

    /// Returns the size of the whole resource in bytes.
    pub(super) fn bytes(&self) -> u64 {
        let levels = (0..).map_while(|level| self.units(level));
        levels.map(|units| (units.count * units.unit_bytes) as u64).sum()
    }

    /// Returns true if the units are rows of a texture.
    pub(super) fn has_rows(&self) -> bool {
        matches!(self.resource, Resource::Layer(..) | Resource::State(..))
    }

    /// Uploads the next `count` units, at most those that remain in the level, and returns their size in bytes. `scratch` is
    /// reused memory for converted bytes.
    pub(super) fn write(&mut self, sink: &mut impl Sink, scratch: &mut Vec<u8>, count: usize) -> u64 {
        let Some(Units { count: all, unit_bytes }) = self.units(self.level) else { return 0 };
        let part = self.done..all.min(self.done + count);
        match &self.resource {
            Resource::Copy(copy) => sink.copy_block(copy),
            Resource::Layer(source, LayerDestination { texture, layer }) => {
                let rows = TextureRows {
                    layer: *layer,
                    level: self.level,
                    first: part.start as u32,
                    count: part.len() as u32,
                    width: source.width(self.level),
                    row_bytes: unit_bytes as u32,
                    block_side: source.format().block_side(),
                };
                let range = part.start * unit_bytes..part.end * unit_bytes;
                sink.write_rows(texture, &rows, &source.texels(self.level)[range]);
            }
            Resource::State(object, texture) => {
                let Some((level, layer)) = layer_of(object, self.level) else { return 0 };
                let rows = TextureRows {
                    layer,
                    level,
                    first: part.start as u32,
                    count: part.len() as u32,
                    width: object.level_size(level)[0],
                    row_bytes: unit_bytes as u32,
                    block_side: 1,
                };
                let start = layer as usize * all;
                let range = (start + part.start) * unit_bytes..(start + part.end) * unit_bytes;
                sink.write_rows(texture, &rows, &object.texels[level as usize][range]);
            }
            Resource::Buffer(source, BufferDestination { buffer, offset }) => {
                let offset = offset + (part.start * unit_bytes) as u64;
                match source {
                    BufferSource::HeightTable(tile) => {
                        sink.write_bytes(buffer, offset, bytemuck::cast_slice(&table_words(tile)));
                    }
                    BufferSource::Vertices(mesh, _) if !mesh.attributes.is_empty() => {
                        sink.write_bytes(buffer, offset, interleaved_bytes(mesh, part.clone(), scratch));
                    }
                    BufferSource::Vertices(mesh, format) => {
                        sink.write_bytes(buffer, offset, format.bytes(&mesh.vertices[part.clone()], scratch));
                    }
                    BufferSource::Indices(mesh) => {
                        sink.write_bytes(buffer, offset, bytemuck::cast_slice(&mesh.indices[part.clone()]));
                    }
                    BufferSource::ShortIndices(mesh) => {
                        let indices = 2 * part.start..mesh.indices.len().min(2 * part.end);
                        sink.write_bytes(buffer, offset, short_index_bytes(&mesh.indices[indices], scratch));
                    }
                    BufferSource::Splats(splats) => {
                        sink.write_bytes(buffer, offset, bytemuck::cast_slice(&splats.list()[part.clone()]));
                    }
                    BufferSource::SplatHarmonics(splats) => {
                        let words = part.start * unit_bytes / 4..part.end * unit_bytes / 4;
                        sink.write_bytes(buffer, offset, bytemuck::cast_slice(&splats.harmonics().words()[words]));
                    }
                }
            }
        }
        self.done = part.end;
        if self.done >= all {
            (self.level, self.done) = (self.level + 1, 0);
        }
        (part.len() * unit_bytes) as u64
    }

    /// Uploads everything that remains by the queue.
    pub(super) fn write_all(mut self, sink: &mut QueueSink<'_>, scratch: &mut Vec<u8>) {
        while let Some(remaining) = self.remaining() {
            self.write(sink, scratch, remaining.count);
        }
    }
}

/// Returns level and layer by the number of a layer, counted over all levels that have texels.
fn layer_of(object: &TextureObject, number: u32) -> Option<(u32, u32)> {
    let mut left = number;
    for level in 0..object.texels.len() as u32 {
        let layers = object.level_size(level)[2];
        if left < layers {
            return Some((level, left));
        }
        left -= layers;
    }
    None
}

impl ImageSource {
    /// Returns the rows of a level, of texels or of blocks; `None` beyond the last level.
    fn rows(&self, level: u32) -> Option<Units> {
        let height = match self {
            Self::Image(image) => image.mips.get(level as usize).map(|_| (image.height >> level).max(1))?,
            _ if level > 0 => return None,
            Self::Heights(tile) => tile.side + 2,
            Self::White => 1,
        };
        let format = self.format();
        let unit_bytes = format.row_bytes(self.width(level)) as usize;
        Some(Units { count: format.rows(height) as usize, unit_bytes })
    }

    /// Returns the width of an existing level in texels.
    fn width(&self, level: u32) -> u32 {
        match self {
            Self::Heights(tile) => tile.side + 2,
            Self::Image(image) => (image.width >> level).max(1),
            Self::White => 1,
        }
    }

    /// Returns the format; RGBA8 for heights too, which have 4 bytes a texel.
    fn format(&self) -> TexelFormat {
        match self {
            Self::Image(image) => image.format,
            Self::Heights(_) | Self::White => TexelFormat::Rgba8,
        }
    }

    /// Returns the bytes of an existing level.
    fn texels(&self, level: u32) -> &[u8] {
        match self {
            Self::Heights(tile) => bytemuck::cast_slice(&tile.heights),
            Self::Image(image) => &image.mips[level as usize],
            Self::White => &[255; 4],
        }
    }
}

impl BufferSource {
    fn units(&self) -> Units {
        match self {
            Self::HeightTable(tile) => Units { count: 1, unit_bytes: table_bytes(tile.side) as usize },
            Self::Vertices(mesh, format) => Units {
                count: mesh.vertices.len(),
                unit_bytes: format.stride() + added_stride(mesh.attributes.layout()),
            },
            Self::Indices(mesh) => Units { count: mesh.indices.len(), unit_bytes: 4 },
            Self::ShortIndices(mesh) => Units { count: mesh.indices.len().div_ceil(2), unit_bytes: 4 },
            Self::Splats(splats) => Units { count: splats.list().len(), unit_bytes: size_of::<Splat>() },
            Self::SplatHarmonics(splats) => {
                let count = splats.list().len();
                Units { count, unit_bytes: splats.harmonics().size_bytes() as usize / count.max(1) }
            }
        }
    }
}
