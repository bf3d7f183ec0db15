//! The formats of vertices and indices in GPU memory: packed where nothing visible is lost. Draw thread, or the compile
//! thread; plain values.
//!
//! ```text
//! full      28 bytes   position 3 x f32   uv 2 x f32       normal 4 x snorm8   color 4 x unorm8
//! packed    20 bytes   position 3 x f32   uv 2 x unorm16   normal 4 x snorm8   white, from a buffer of one texel
//! quantized 16 bytes   position 4 x unorm16, w unused      uv and normal as packed ones
//! ```
//! - Packed: meshes that are white and whose texture coordinates lie in 0..1. A step of unorm16 is a sixteenth of a texel
//!   of an image 4,096 texels wide.
//! - Quantized: packed meshes that were read from positions of normalized 16 bits, which a transform above scales to
//!   metres.
//! - Full: all others, and small meshes, whose vertices shaders fetch themselves. Custom attributes follow each full
//!   vertex.
//!
//! These are the formats of KHR_mesh_quantization. The vertex stage converts them to floats, so that shaders see no
//! difference. Indices have 16 bits where they fit.

use std::ops::Range;

pub(crate) use crate::scene::VertexFormat;
use crate::scene::{Mesh, MeshVertex, SMALL_MESH_INDICES, added_stride};

/// The colour of packed meshes.
pub(super) const WHITE: [u8; 4] = [255; 4];

/// A packed vertex.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct PackedVertex {
    position: [f32; 3],
    uv: [u16; 2],
    normal: [i8; 4],
}

/// A quantized vertex.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct QuantizedVertex {
    position: [u16; 4],
    uv: [u16; 2],
    normal: [i8; 4],
}

/// Rounds to the nearest. In an f32 from 2^23 on, the lowest bit is one.
fn unorm16(x: f32) -> u16 {
    (x.clamp(0.0, 1.0) * 65535.0 + 8_388_608.0).to_bits() as u16
}

impl VertexFormat {
    /// Returns the size of a vertex in bytes, without custom attributes.
    pub(crate) const fn stride(self) -> usize {
        match self {
            Self::Full => size_of::<MeshVertex>(),
            Self::Packed => size_of::<PackedVertex>(),
            Self::Quantized => size_of::<QuantizedVertex>(),
        }
    }

    /// Returns the bytes of vertices in this format. Converted vertices are written to `scratch`.
    pub(in crate::gpu) fn bytes<'a>(self, vertices: &'a [MeshVertex], scratch: &'a mut Vec<u8>) -> &'a [u8] {
        match self {
            Self::Full => bytemuck::cast_slice(vertices),
            Self::Packed => converted(vertices, scratch, |v| PackedVertex {
                position: v.position,
                uv: v.uv.map(unorm16),
                normal: v.normal,
            }),
            Self::Quantized => converted(vertices, scratch, |v| {
                let [x, y, z] = v.position.map(unorm16);
                QuantizedVertex { position: [x, y, z, 0], uv: v.uv.map(unorm16), normal: v.normal }
            }),
        }
    }
}

/// Writes converted vertices to `scratch` and returns their bytes.
fn converted<'a, T: bytemuck::Pod>(
    vertices: &[MeshVertex],
    scratch: &'a mut Vec<u8>,
    make: impl Fn(&MeshVertex) -> T,
) -> &'a [u8] {
    let scratch = resized(scratch, vertices.len() * size_of::<T>());
    for (vertex, bytes) in vertices.iter().zip(scratch.chunks_exact_mut(size_of::<T>())) {
        bytes.copy_from_slice(bytemuck::bytes_of(&make(vertex)));
    }
    scratch
}

/// Returns the first `bytes` of the scratch memory, with the contents of earlier calls.
fn resized(scratch: &mut Vec<u8>, bytes: usize) -> &mut [u8] {
    if scratch.len() < bytes {
        scratch.resize(bytes, 0);
    }
    &mut scratch[..bytes]
}

/// Returns the bytes of a part of a mesh's vertices, each followed by its custom attributes.
pub(in crate::gpu) fn interleaved_bytes<'a>(mesh: &Mesh, part: Range<usize>, scratch: &'a mut Vec<u8>) -> &'a [u8] {
    let mut at = size_of::<MeshVertex>();
    let stride = at + added_stride(mesh.attributes.layout());
    let scratch = resized(scratch, part.len() * stride);
    let first = part.start;
    for (vertex, bytes) in mesh.vertices[part].iter().zip(scratch.chunks_exact_mut(stride)) {
        bytes[..at].copy_from_slice(bytemuck::bytes_of(vertex));
    }
    for (_, format, elements) in mesh.attributes.iter() {
        let elements = elements.chunks_exact(format.size_bytes()).skip(first);
        for (element, bytes) in elements.zip(scratch.chunks_exact_mut(stride)) {
            bytes[at..][..element.len()].copy_from_slice(element);
        }
        at += format.size_bytes();
    }
    scratch
}

/// Returns true if a list of `count` indices is stored with 16 bits. Short lists never are, since shaders fetch them
/// themselves.
pub(super) fn fits_short_indices(max_index: u32, count: usize) -> bool {
    // Some adapters restart primitives at the largest value of 16 bits.
    max_index < u32::from(u16::MAX) && count > SMALL_MESH_INDICES as usize
}

/// Returns the bytes of indices with 16 bits, padded to a multiple of 4 bytes.
pub(in crate::gpu) fn short_index_bytes<'a>(indices: &[u32], scratch: &'a mut Vec<u8>) -> &'a [u8] {
    let bytes = 2 * indices.len();
    let scratch = resized(scratch, bytes.next_multiple_of(4));
    for (index, short) in indices.iter().zip(scratch.as_chunks_mut::<2>().0) {
        *short = (*index as u16).to_ne_bytes();
    }
    scratch[bytes..].fill(0);
    scratch
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{AttributeFormat, Drawable, Material, Topology};

    fn mesh(change: impl Fn(&mut MeshVertex)) -> Mesh {
        let mut vertices: Vec<MeshVertex> = (0..30)
            .map(|i| {
                let x = i as f32 / 29.0;
                MeshVertex { position: [x, -x, 1e4 * x], uv: [x, 1.0 - x], normal: [i as i8, 0, 0, 0], color: WHITE }
            })
            .collect();
        change(&mut vertices[17]);
        Mesh::new(vertices, (0..30).chain(0..30).collect(), Topology::Triangles)
    }

    #[test]
    fn meshes_that_would_lose_detail_are_not_packed() {
        let of = |change: fn(&mut MeshVertex)| Drawable::new(mesh(change).into(), Material::default()).vertex_format();
        assert_eq!(of(|_| {}), VertexFormat::Packed);
        assert_eq!(of(|v| v.uv[0] = 1.000001), VertexFormat::Packed, "rounding of 1");
        assert_eq!(of(|v| v.uv[1] = 1.01), VertexFormat::Full);
        assert_eq!(of(|v| v.uv[1] = -0.01), VertexFormat::Full);
        assert_eq!(of(|v| v.uv[1] = f32::NAN), VertexFormat::Full);
        assert_eq!(of(|v| v.color[3] = 254), VertexFormat::Full);
        let mut small = mesh(|_| {});
        small.indices = (0..30).collect();
        assert_eq!(Drawable::new(small.into(), Material::default()).vertex_format(), VertexFormat::Full);
        let further = mesh(|_| {}).with_attribute("id", AttributeFormat::Uint32, &[7u32; 30]).unwrap();
        assert_eq!(Drawable::new(further.into(), Material::default()).vertex_format(), VertexFormat::Full);
    }

    #[test]
    fn packed_vertices_keep_their_precision() {
        let (mesh, mut scratch) = (mesh(|_| {}), Vec::new());
        let bytes = VertexFormat::Packed.bytes(&mesh.vertices, &mut scratch);
        assert_eq!(bytes.len(), 30 * 20);
        for (vertex, packed) in mesh.vertices.iter().zip(bytes.chunks_exact(20)) {
            let packed: PackedVertex = bytemuck::pod_read_unaligned(packed);
            assert_eq!((packed.position, packed.normal), (vertex.position, vertex.normal));
            for k in 0..2 {
                assert!((f32::from(packed.uv[k]) / 65535.0 - vertex.uv[k]).abs() <= 0.51 / 65535.0);
            }
        }
        let ends = [mesh.vertices[0], mesh.vertices[29]];
        let bytes = VertexFormat::Packed.bytes(&ends, &mut scratch);
        let uv = |i: usize| bytemuck::pod_read_unaligned::<PackedVertex>(&bytes[20 * i..20 * i + 20]).uv;
        assert_eq!([uv(0), uv(1)], [[0, u16::MAX], [u16::MAX, 0]]);
    }

    #[test]
    fn attributes_follow_their_vertices() {
        let ids: Vec<u32> = (100..130).collect();
        let tangents: Vec<[f32; 2]> = (0..30).map(|i| [i as f32, -1.0]).collect();
        let mesh = mesh(|_| {})
            .with_attribute("id", AttributeFormat::Uint32, &ids)
            .and_then(|mesh| mesh.with_attribute("tangent", AttributeFormat::Float32x2, &tangents))
            .unwrap();
        let mut scratch = vec![7; 5000];
        let bytes = interleaved_bytes(&mesh, 10..13, &mut scratch);
        assert_eq!(bytes.len(), 3 * 40);
        for (i, bytes) in (10..).zip(bytes.chunks_exact(40)) {
            assert_eq!(bytemuck::pod_read_unaligned::<MeshVertex>(&bytes[..28]), mesh.vertices[i]);
            assert_eq!(bytemuck::pod_read_unaligned::<u32>(&bytes[28..32]), ids[i]);
            assert_eq!(bytemuck::pod_read_unaligned::<[f32; 2]>(&bytes[32..]), tangents[i]);
        }
    }

    #[test]
    fn quantized_positions_are_exact() {
        let steps = [0u16, 1, 2, 255, 256, 32_767, 32_768, 65_534, 65_535];
        let vertex = |i: usize| MeshVertex {
            position: [0, 3, 5].map(|k| f32::from(steps[(i + k) % steps.len()]) / 65535.0),
            uv: [0.25, 1.0],
            normal: [1, 2, -3, 0],
            color: WHITE,
        };
        let (vertices, mut scratch): (Vec<MeshVertex>, _) = ((0..steps.len()).map(vertex).collect(), Vec::new());
        let bytes = VertexFormat::Quantized.bytes(&vertices, &mut scratch);
        assert_eq!(bytes.len(), 16 * vertices.len());
        for (i, got) in bytes.chunks_exact(16).enumerate() {
            let got: QuantizedVertex = bytemuck::pod_read_unaligned(got);
            let [x, y, z] = [0, 3, 5].map(|k| steps[(i + k) % steps.len()]);
            assert_eq!((got.position, got.uv, got.normal), ([x, y, z, 0], [16_384, 65_535], [1, 2, -3, 0]));
        }
    }

    #[test]
    fn vertex_format_is_not_kept_for_a_replaced_mesh() {
        let of =
            |mesh: Mesh| Drawable::new(mesh.into(), Material::default()).with_vertex_format(VertexFormat::Quantized);
        let mut drawable = of(mesh(|_| {}));
        assert_eq!(drawable.vertex_format(), VertexFormat::Quantized);
        drawable.geometry = mesh(|v| v.color[0] = 0).into();
        assert_eq!(drawable.vertex_format(), VertexFormat::Full);
        let mut small = mesh(|_| {});
        small.indices = (0..30).collect();
        assert_eq!(of(small).vertex_format(), VertexFormat::Full);
    }

    #[test]
    fn short_indices_are_padded_to_whole_words() {
        let mut scratch = Vec::new();
        // The scratch memory has the contents of earlier calls.
        assert_eq!(short_index_bytes(&[7; 9], &mut scratch).len(), 20);
        let bytes = short_index_bytes(&[1, 2, 65534], &mut scratch);
        assert_eq!(bytemuck::pod_collect_to_vec::<u8, u16>(bytes), [1, 2, 65534, 0]);
        assert!(fits_short_indices(65534, 49) && !fits_short_indices(65535, 49) && !fits_short_indices(5, 48));
    }
}
