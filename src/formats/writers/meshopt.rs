//! Compression of buffer views by EXT_meshopt_compression, and the order of vertices and triangles.

use meshoptimizer_rs::codec::{
    IndexEncoding, VertexEncoding, encode_filter_oct, encode_index_buffer, encode_vertex_buffer,
};
use meshoptimizer_rs::{Workspace, optimize_vertex_cache};
use serde_json::{Value, json};

use super::GlbMesh;

/// How a buffer view is compressed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Compression {
    /// Vertex attributes of `stride` bytes, a multiple of 4.
    Attributes { stride: usize },
    /// Normals of three signed bytes and a byte of padding, stored as points of an octahedron.
    Normals { stride: usize },
    /// Indices of `size` bytes, 2 or 4, three for each triangle.
    Triangles { size: usize },
}

impl Compression {
    /// Returns the members of the extension that say how to decompress a view of `bytes` bytes.
    pub fn properties(self, bytes: usize) -> Value {
        match self {
            Self::Attributes { stride } => {
                json!({ "byteStride": stride, "count": bytes / stride, "mode": "ATTRIBUTES" })
            }
            Self::Normals { stride } => {
                json!({ "byteStride": stride, "count": bytes / stride, "mode": "ATTRIBUTES", "filter": "OCTAHEDRAL" })
            }
            Self::Triangles { size } => json!({ "byteStride": size, "count": bytes / size, "mode": "TRIANGLES" }),
        }
    }
}

/// Compresses the bytes of a buffer view. Returns `None` for a view that the encoder does not take, such as an empty one; it is
/// then written as it is.
pub(super) fn compress(bytes: &[u8], compression: Compression) -> Option<Vec<u8>> {
    if bytes.is_empty() {
        return None;
    }
    let mut workspace = Workspace::default();
    // The version of the bit stream that the extension defines; it has no levels.
    let encoding = VertexEncoding::new(0, 0).ok()?;
    match compression {
        Compression::Attributes { stride } => {
            encode_vertex_buffer(bytes, bytes.len() / stride, stride, encoding, &mut workspace).ok()
        }
        Compression::Normals { stride } => {
            let count = bytes.len() / stride;
            let float = |byte: &u8| f32::from(byte.cast_signed()) / 127.0;
            let normals: Vec<f32> = bytes.iter().map(float).collect();
            let filtered = encode_filter_oct(count, stride, 8, &normals, &mut workspace).ok()?;
            encode_vertex_buffer(&filtered, count, stride, encoding, &mut workspace).ok()
        }
        Compression::Triangles { size } => {
            let index = |b: &[u8]| b.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte));
            let indices: Vec<u32> = bytes.chunks_exact(size).map(index).collect();
            encode_index_buffer(&indices, IndexEncoding::default(), &mut workspace).ok()
        }
    }
}

impl GlbMesh {
    /// Orders the triangles for the GPU's cache of transformed vertices, and the vertices by their first use, so that they are
    /// fetched in order. Vertices that no triangle uses are removed. A mesh with incomplete triangles, invalid indices or
    /// attributes of unequal length stays as it is.
    pub fn optimize_order(&mut self) {
        let count = self.positions.len();
        let is_attribute = |length: usize| length == 0 || length == count;
        let indices: Vec<u32> = self.indices.iter().copied().map(u32::from).collect();
        let ordered = optimize_vertex_cache(&indices, count, &mut Workspace::default());
        let Some(ordered) = ordered.ok().filter(|_| is_attribute(self.normals.len()) && is_attribute(self.uvs.len()))
        else {
            return;
        };
        let mut old_of_new: Vec<usize> = Vec::with_capacity(count);
        let mut new_of_old: Vec<Option<u16>> = vec![None; count];
        self.indices = ordered
            .into_iter()
            .map(|old| {
                *new_of_old[old as usize].get_or_insert_with(|| {
                    old_of_new.push(old as usize);
                    (old_of_new.len() - 1) as u16
                })
            })
            .collect();
        self.positions = old_of_new.iter().map(|old| self.positions[*old]).collect();
        if !self.normals.is_empty() {
            self.normals = old_of_new.iter().map(|old| self.normals[*old]).collect();
        }
        if !self.uvs.is_empty() {
            self.uvs = old_of_new.iter().map(|old| self.uvs[*old]).collect();
        }
    }
}
