//! One thing to upload, and how far it is: what its bytes are and where they go, whoever carries them. Draw thread, or
//! the compile thread of a context that has one.

use std::sync::Arc;

use super::height_pool::{table_vectors, table_words};
use super::packing::{VertexFormat, interleaved, short_indices};
use super::texture_pool::{Rows, write_rows};
use crate::scene::{HeightTile, Mesh, Texture, added_stride};

/// What carries bytes to the adapter.
pub(super) trait Sink {
    /// Writes whole rows of a texture of four bytes a texel; `data` holds exactly these.
    fn write_rows(&mut self, texture: &wgpu::Texture, rows: &Rows, data: &[u8]);

    /// Writes a part of a buffer, a multiple of four bytes.
    fn write_bytes(&mut self, buffer: &wgpu::Buffer, offset: u64, data: &[u8]);
}

/// By the queue itself; only on the thread that submits.
pub(super) struct QueueSink<'a>(pub(super) &'a wgpu::Queue);

impl Sink for QueueSink<'_> {
    fn write_rows(&mut self, texture: &wgpu::Texture, rows: &Rows, data: &[u8]) {
        write_rows(self.0, texture, rows, data);
    }

    fn write_bytes(&mut self, buffer: &wgpu::Buffer, offset: u64, data: &[u8]) {
        self.0.write_buffer(buffer, offset, data);
    }
}

/// What is uploaded.
pub(super) enum Source {
    Heights(Arc<HeightTile>),
    Tables(Arc<HeightTile>),
    Image(Arc<Texture>),
    /// One white texel.
    White,
    Vertices(Arc<Mesh>, VertexFormat),
    Indices(Arc<Mesh>),
    /// Of 16 bits, two a unit.
    ShortIndices(Arc<Mesh>),
}

/// Its place; keeps the texture or buffer alive.
pub(super) enum Destination {
    Layer(wgpu::Texture, u32),
    /// From an offset in bytes on.
    Buffer(wgpu::Buffer, u64),
}

/// One thing left to upload, and how far it is: level, and row, vertex or index in it.
pub(super) struct Upload {
    source: Source,
    into: Destination,
    level: u32,
    cursor: usize,
}

impl Upload {
    pub(super) fn new(source: Source, into: Destination) -> Self {
        Self { source, into, level: 0, cursor: 0 }
    }

    /// Units (rows, vertices, indices) of the present level that are left, and the bytes of one; `None` when all is
    /// done. Never without units: the pools refuse empty meshes and images.
    pub(super) fn left(&self) -> Option<(usize, usize)> {
        let (units, unit_bytes) = self.source.extent(self.level)?;
        Some((units - self.cursor, unit_bytes))
    }

    /// Bytes of all of it.
    pub(super) fn bytes(&self) -> u64 {
        let levels = (0..).map_while(|level| self.source.extent(level));
        levels.map(|(units, unit_bytes)| (units * unit_bytes) as u64).sum()
    }

    /// True where it goes row by row into a texture.
    pub(super) fn has_rows(&self) -> bool {
        matches!(self.into, Destination::Layer(..))
    }

    /// Uploads the next `count` units, at most those that are left in the level; their bytes. `scratch` is for bytes that
    /// are made on the way, used again from call to call.
    pub(super) fn write(&mut self, sink: &mut impl Sink, scratch: &mut Vec<u8>, count: usize) -> u64 {
        let Some((units, unit_bytes)) = self.source.extent(self.level) else { return 0 };
        let end = units.min(self.cursor + count);
        let part = self.cursor..end;
        let bytes = ((end - self.cursor) * unit_bytes) as u64;
        match &self.into {
            Destination::Layer(texture, layer) => {
                let rows = Rows {
                    layer: *layer,
                    level: self.level,
                    first: part.start as u32,
                    count: part.len() as u32,
                    width: (unit_bytes / 4) as u32,
                };
                let range = part.start * unit_bytes..part.end * unit_bytes;
                match &self.source {
                    Source::Heights(tile) => {
                        sink.write_rows(texture, &rows, &bytemuck::cast_slice(&tile.heights)[range]);
                    }
                    Source::Image(image) => sink.write_rows(texture, &rows, &image.mips[self.level as usize][range]),
                    Source::White => sink.write_rows(texture, &rows, &[255; 4]),
                    Source::Tables(_) | Source::Vertices(..) | Source::Indices(_) | Source::ShortIndices(_) => {
                        debug_assert!(false, "what is no image goes into a buffer");
                    }
                }
            }
            Destination::Buffer(buffer, offset) => {
                let offset = offset + (part.start * unit_bytes) as u64;
                match &self.source {
                    Source::Tables(tile) => sink.write_bytes(buffer, offset, bytemuck::cast_slice(&table_words(tile))),
                    Source::Vertices(mesh, _) if !mesh.attributes.is_empty() => {
                        sink.write_bytes(buffer, offset, interleaved(mesh, part, scratch));
                    }
                    Source::Vertices(mesh, format) => {
                        sink.write_bytes(buffer, offset, format.bytes(&mesh.vertices[part], scratch));
                    }
                    Source::ShortIndices(mesh) => {
                        let part = 2 * part.start..mesh.indices.len().min(2 * part.end);
                        sink.write_bytes(buffer, offset, short_indices(&mesh.indices[part], scratch));
                    }
                    Source::Indices(mesh) => {
                        sink.write_bytes(buffer, offset, bytemuck::cast_slice(&mesh.indices[part]));
                    }
                    Source::Heights(_) | Source::Image(_) | Source::White => {
                        debug_assert!(false, "an image goes into a texture");
                    }
                }
            }
        }
        self.cursor = end;
        if end >= units {
            self.level += 1;
            self.cursor = 0;
        }
        bytes
    }
}

impl Source {
    /// Units of a level and the bytes of one; `None` beyond the last level.
    fn extent(&self, level: u32) -> Option<(usize, usize)> {
        match self {
            Self::Image(image) => {
                image.mips.get(level as usize)?;
                let [width, height] = [image.width, image.height].map(|side| (side >> level).max(1) as usize);
                Some((height, width * 4))
            }
            _ if level > 0 => None,
            Self::Heights(tile) => Some((tile.side as usize + 2, (tile.side as usize + 2) * 4)),
            Self::Tables(tile) => Some((1, table_vectors(tile.side) as usize * 16)),
            Self::White => Some((1, 4)),
            Self::Vertices(mesh, format) => {
                Some((mesh.vertices.len(), format.stride() + added_stride(mesh.attributes.layout())))
            }
            Self::ShortIndices(mesh) => Some((mesh.indices.len().div_ceil(2), 4)),
            Self::Indices(mesh) => Some((mesh.indices.len(), 4)),
        }
    }
}
