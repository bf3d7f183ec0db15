//! How vertices and indices lie in the pools: smaller than they come, where nothing visible is lost.
//!
//! ```text
//! full      28 bytes   position 3 x f32   uv 2 x f32       normal 4 x snorm8   color 4 x unorm8
//! packed    20 bytes   position 3 x f32   uv 2 x unorm16   normal 4 x snorm8   white, from a buffer of one texel
//! quantized 16 bytes   position 4 x unorm16, w unused      uv and normal as packed ones
//! ```
//! Packed are meshes that are white and whose texture coordinates lie in 0..1 (a step of unorm16 is a sixteenth of a texel
//! of an image 4,096 texels wide); quantized those of them that were read from positions of normalized 16 bits, which a
//! transform above makes metres. The formats of KHR_mesh_quantization; the vertex stage makes floats of them, so that
//! shaders see no difference. Small meshes, which shaders fetch themselves, are full. Further attributes of a mesh lie
//! behind its full vertices. Indices are 16 bits where they fit.

pub(crate) use crate::scene::VertexFormat;
use crate::scene::{Mesh, MeshVertex, SMALL_MESH_INDICES, added_stride};

/// The color of packed meshes.
pub(crate) const WHITE: [u8; 4] = [255; 4];

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

/// Rounded to the nearest: among numbers from 2^23 on, a whole is the lowest bit.
fn unorm16(x: f32) -> u16 {
    (x.clamp(0.0, 1.0) * 65535.0 + 8_388_608.0).to_bits() as u16
}

impl VertexFormat {
    /// Bytes of a vertex.
    pub(crate) const fn stride(self) -> usize {
        match self {
            Self::Full => size_of::<MeshVertex>(),
            Self::Packed => size_of::<PackedVertex>(),
            Self::Quantized => size_of::<QuantizedVertex>(),
        }
    }

    /// The bytes of some vertices; `scratch` is for those that are made.
    pub(super) fn bytes<'a>(self, vertices: &'a [MeshVertex], scratch: &'a mut Vec<u8>) -> &'a [u8] {
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

/// The bytes of vertices of another kind.
fn converted<'a, T: bytemuck::Pod>(
    vertices: &[MeshVertex],
    scratch: &'a mut Vec<u8>,
    make: impl Fn(&MeshVertex) -> T,
) -> &'a [u8] {
    let scratch = room(scratch, vertices.len() * size_of::<T>());
    for (vertex, place) in vertices.iter().zip(scratch.chunks_exact_mut(size_of::<T>())) {
        place.copy_from_slice(bytemuck::bytes_of(&make(vertex)));
    }
    scratch
}

/// So many bytes of what is there of earlier calls, to be written over.
fn room(scratch: &mut Vec<u8>, bytes: usize) -> &mut [u8] {
    if scratch.len() < bytes {
        scratch.resize(bytes, 0);
    }
    &mut scratch[..bytes]
}

/// The bytes of some vertices of a mesh, the further attributes of each behind it.
pub(super) fn interleaved<'a>(mesh: &Mesh, part: std::ops::Range<usize>, scratch: &'a mut Vec<u8>) -> &'a [u8] {
    let mut at = size_of::<MeshVertex>();
    let stride = at + added_stride(mesh.attributes.layout());
    let scratch = room(scratch, part.len() * stride);
    let first = part.start;
    for (vertex, place) in mesh.vertices[part].iter().zip(scratch.chunks_exact_mut(stride)) {
        place[..at].copy_from_slice(bytemuck::bytes_of(vertex));
    }
    for (_, format, elements) in mesh.attributes.iter() {
        let elements = elements.chunks_exact(format.size_bytes()).skip(first);
        for (element, place) in elements.zip(scratch.chunks_exact_mut(stride)) {
            place[at..][..element.len()].copy_from_slice(element);
        }
        at += format.size_bytes();
    }
    scratch
}

/// Whether a list's indices take 16 bits. Short lists never do: shaders fetch them themselves.
pub(super) fn is_short(largest: u32, count: usize) -> bool {
    // The largest of 16 bits is no index in all topologies of all adapters.
    largest < u32::from(u16::MAX) && count > SMALL_MESH_INDICES as usize
}

/// The bytes of some indices of 16 bits, a whole number of 4.
pub(super) fn short_indices<'a>(indices: &[u32], scratch: &'a mut Vec<u8>) -> &'a [u8] {
    scratch.clear();
    for index in indices {
        scratch.extend_from_slice(&(*index as u16).to_ne_bytes());
    }
    scratch.resize(scratch.len().next_multiple_of(4), 0);
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
    fn what_would_be_lost_is_not_packed() {
        let of = |change: fn(&mut MeshVertex)| Drawable::new(mesh(change).into(), Material::default()).vertex_format();
        assert_eq!(of(|_| {}), VertexFormat::Packed);
        assert_eq!(of(|v| v.uv[0] = 1.000001), VertexFormat::Packed, "rounding of a whole");
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
    fn packed_vertices_are_as_good_as_they_were() {
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
    fn attributes_lie_behind_their_vertices() {
        let ids: Vec<u32> = (100..130).collect();
        let tangents: Vec<[f32; 2]> = (0..30).map(|i| [i as f32, -1.0]).collect();
        let mesh = mesh(|_| {})
            .with_attribute("id", AttributeFormat::Uint32, &ids)
            .and_then(|mesh| mesh.with_attribute("tangent", AttributeFormat::Float32x2, &tangents))
            .unwrap();
        let mut scratch = vec![7; 5000];
        let bytes = interleaved(&mesh, 10..13, &mut scratch);
        assert_eq!(bytes.len(), 3 * 40);
        for (i, bytes) in (10..).zip(bytes.chunks_exact(40)) {
            assert_eq!(bytemuck::pod_read_unaligned::<MeshVertex>(&bytes[..28]), mesh.vertices[i]);
            assert_eq!(bytemuck::pod_read_unaligned::<u32>(&bytes[28..32]), ids[i]);
            assert_eq!(bytemuck::pod_read_unaligned::<[f32; 2]>(&bytes[32..]), tangents[i]);
        }
    }

    #[test]
    fn positions_of_16_bits_come_back_as_they_were() {
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
    fn what_is_known_of_a_mesh_is_not_held_of_another() {
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
    fn indices_of_16_bits_fill_whole_words() {
        let mut scratch = Vec::new();
        assert_eq!(short_indices(&[1, 2, 65534], &mut scratch).len(), 8);
        assert_eq!(bytemuck::pod_collect_to_vec::<u8, u16>(&scratch), [1, 2, 65534, 0]);
        assert!(is_short(65534, 49) && !is_short(65535, 49) && !is_short(5, 48));
    }
}
