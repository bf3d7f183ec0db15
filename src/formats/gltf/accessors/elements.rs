//! [`Elements`]: the elements of an accessor, converted to numbers or copied as bytes.

use std::borrow::Cow;
use std::sync::Arc;

use gltf::accessor::{DataType, Dimensions};

use crate::scene::{AttributeFormat, MeshVertex};

/// The elements of an accessor. [`Buffers::elements`](super::Buffers::elements) has checked offsets and counts.
pub(in super::super) struct Elements<'a> {
    pub bytes: Cow<'a, [u8]>,
    pub stride: usize,
    pub count: usize,
    pub components: usize,
    pub data_type: DataType,
    pub normalized: bool,
}

impl Elements<'_> {
    pub fn is_unorm16(&self) -> bool {
        self.data_type == DataType::U16 && self.normalized
    }

    /// Returns one column of each matrix, with `rows` rows.
    pub fn column(&self, column: usize, rows: usize) -> Elements<'_> {
        let first = column * column_stride(self.data_type, rows);
        Elements { bytes: Cow::Borrowed(self.bytes.get(first..).unwrap_or_default()), components: rows, ..*self }
    }

    /// Returns component `c` of element `i`, normalized if the accessor says so. Returns 0 out of range.
    pub fn value(&self, i: usize, c: usize) -> f32 {
        let at = i * self.stride + c * self.data_type.size();
        let b = |n: usize| self.bytes.get(at + n).copied().unwrap_or(0);
        let (raw, max) = match self.data_type {
            DataType::F32 => return f32::from_le_bytes([b(0), b(1), b(2), b(3)]),
            DataType::I8 => (f32::from(b(0) as i8), 127.0),
            DataType::U8 => (f32::from(b(0)), 255.0),
            DataType::I16 => (f32::from(i16::from_le_bytes([b(0), b(1)])), 32767.0),
            DataType::U16 => (f32::from(u16::from_le_bytes([b(0), b(1)])), 65535.0),
            DataType::U32 => (u32::from_le_bytes([b(0), b(1), b(2), b(3)]) as f32, 4_294_967_295.0),
        };
        if self.normalized { (raw / max).max(-1.0) } else { raw }
    }

    /// Returns component `c` of element `i` as an unsigned integer, without normalization. Negative numbers become 0, and
    /// fractions are cut off.
    pub fn unsigned(&self, i: usize, c: usize) -> u32 {
        let at = i * self.stride + c * self.data_type.size();
        let b = |n: usize| self.bytes.get(at + n).copied().unwrap_or(0);
        match self.data_type {
            DataType::U8 => b(0).into(),
            DataType::U16 => u16::from_le_bytes([b(0), b(1)]).into(),
            DataType::U32 => u32::from_le_bytes([b(0), b(1), b(2), b(3)]),
            DataType::I8 => (b(0) as i8).max(0) as u32,
            DataType::I16 => i16::from_le_bytes([b(0), b(1)]).max(0) as u32,
            DataType::F32 => f32::from_le_bytes([b(0), b(1), b(2), b(3)]) as u32,
        }
    }

    /// Returns element `i` as a vector of `N` components. Components that the elements lack are 0.
    pub fn vector<const N: usize>(&self, i: usize) -> [f32; N] {
        std::array::from_fn(|c| if c < self.components { self.value(i, c) } else { 0.0 })
    }

    /// Returns the bytes of all elements without gaps, each padded with zeros to `size` bytes.
    pub fn padded(&self, size: usize) -> Arc<[u8]> {
        let own = self.components * self.data_type.size();
        let mut all = vec![0; self.count * size];
        for (target, bytes) in all.chunks_exact_mut(size.max(1)).zip(self.bytes.chunks(self.stride.max(1))) {
            let own = own.min(size).min(bytes.len());
            target[..own].copy_from_slice(&bytes[..own]);
        }
        all.into()
    }

    /// Calls `set` with each vertex and its element of `N` components, up to the shorter of both lists.
    pub fn read_into<const N: usize>(
        &self,
        vertices: &mut [MeshVertex],
        mut set: impl FnMut(&mut MeshVertex, [f32; N]),
    ) {
        let elements = vertices.iter_mut().zip(self.bytes.chunks(self.stride.max(1)));
        match self.data_type {
            // Dedicated loops for the most frequent types.
            DataType::F32 => elements.for_each(|(vertex, bytes)| {
                let parts = bytes.as_chunks().0.first_chunk::<N>().copied();
                set(vertex, parts.unwrap_or([[0; 4]; N]).map(f32::from_le_bytes));
            }),
            DataType::U16 => {
                let max = if self.normalized { 65535.0 } else { 1.0 };
                elements.for_each(|(vertex, bytes)| {
                    let parts = bytes.as_chunks().0.first_chunk::<N>().copied();
                    set(vertex, parts.unwrap_or([[0; 2]; N]).map(|part| f32::from(u16::from_le_bytes(part)) / max));
                });
            }
            _ => {
                for (i, (vertex, _)) in elements.enumerate() {
                    set(vertex, std::array::from_fn(|k| self.value(i, k)));
                }
            }
        }
    }
}

/// Returns the columns and rows of an element. A vector is one column.
pub(in super::super) fn columns_and_rows(of: Dimensions) -> (usize, usize) {
    match of {
        Dimensions::Mat2 => (2, 2),
        Dimensions::Mat3 => (3, 3),
        Dimensions::Mat4 => (4, 4),
        vector => (1, vector.multiplicity()),
    }
}

/// Returns the bytes from one column of a matrix to the next. Columns begin at multiples of 4 bytes (glTF 2.0, 3.6.2.4).
fn column_stride(of: DataType, rows: usize) -> usize {
    (rows * of.size()).next_multiple_of(4)
}

/// Returns the bytes of an element, and the default stride. The stride of matrices includes the padding of the last column,
/// which the last element may lack.
pub(super) fn element_bytes(of: DataType, dimensions: Dimensions) -> (usize, usize) {
    let (columns, rows) = columns_and_rows(dimensions);
    match columns {
        1 => (rows * of.size(), rows * of.size()),
        _ => ((columns - 1) * column_stride(of, rows) + rows * of.size(), columns * column_stride(of, rows)),
    }
}

/// Returns the vertex format of elements with `components` components. Three components of 8 or 16 bits are padded to four.
pub(in super::super) fn attribute_format(of: DataType, normalized: bool, components: usize) -> Option<AttributeFormat> {
    use AttributeFormat::*;
    let short = |two, four| if components <= 2 { two } else { four };
    let long = |of: [AttributeFormat; 4]| of.get(components - 1).copied();
    match (of, normalized) {
        (DataType::U8, false) => Some(Uint8x4),
        (DataType::I8, false) => Some(Sint8x4),
        (DataType::U8, true) => Some(Unorm8x4),
        (DataType::I8, true) => Some(Snorm8x4),
        (DataType::U16, false) => Some(short(Uint16x2, Uint16x4)),
        (DataType::I16, false) => Some(short(Sint16x2, Sint16x4)),
        (DataType::U16, true) => Some(short(Unorm16x2, Unorm16x4)),
        (DataType::I16, true) => Some(short(Snorm16x2, Snorm16x4)),
        (DataType::U32, _) => long([Uint32, Uint32x2, Uint32x3, Uint32x4]),
        (DataType::F32, _) => long([Float32, Float32x2, Float32x3, Float32x4]),
    }
}
