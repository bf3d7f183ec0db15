//! Small compressed files: Draco, meshopt and KTX2.

use draco_core::{
    DataType, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, Mesh, MeshEncoder, PointAttribute,
};
use meshoptimizer_rs::Workspace;
use meshoptimizer_rs::codec::{IndexEncoding, VertexEncoding, encode_index_buffer, encode_vertex_buffer};

/// A triangle list with positions and 8-bit RGBA colours.
pub struct Triangles {
    /// Positions, three numbers a vertex.
    pub positions: Vec<f32>,
    /// Indices, three a triangle.
    pub indices: Vec<u32>,
}

impl Triangles {
    /// Returns a wavy grid of `side` x `side` vertices.
    pub fn grid(side: u32) -> Self {
        let positions =
            (0..side * side).flat_map(|i| [(i % side) as f32, (i / side) as f32, (i % 5) as f32 * 0.25]).collect();
        let cell = |i: u32| {
            let at = i / (side - 1) * side + i % (side - 1);
            [at, at + 1, at + side, at + side, at + 1, at + side + 1]
        };
        Self { positions, indices: (0..(side - 1) * (side - 1)).flat_map(cell).collect() }
    }

    /// Returns the number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.positions.len() / 3
    }

    /// Returns the positions as bytes.
    pub fn position_bytes(&self) -> Vec<u8> {
        self.positions.iter().flat_map(|x| x.to_le_bytes()).collect()
    }

    /// Returns a Draco mesh: attribute 0 are the positions in 14 bits, attribute 1 the colours `[i, 0, 255 - i, 255]`.
    /// Compression level 0 has sequential connectivity, others are edge-breaker.
    pub fn draco(&self, compression_level: i32) -> Vec<u8> {
        let count = self.vertex_count();
        let attribute = |kind, components: u8, data_type, bytes: &[u8]| {
            let mut attribute = PointAttribute::new();
            attribute.init(kind, components, data_type, false, count);
            attribute.buffer_mut().write(0, bytes);
            attribute
        };
        let mut mesh = Mesh::new();
        let positions = self.position_bytes();
        mesh.add_attribute(attribute(GeometryAttributeType::Position, 3, DataType::Float32, &positions));
        let colors: Vec<u8> = (0..count).flat_map(|i| [i as u8, 0, 255 - i as u8, 255]).collect();
        mesh.add_attribute(attribute(GeometryAttributeType::Color, 4, DataType::Uint8, &colors));
        mesh.set_num_faces(self.indices.len() / 3);
        for (i, t) in self.indices.chunks_exact(3).enumerate() {
            mesh.set_face(FaceIndex(i as u32), [t[0].into(), t[1].into(), t[2].into()]);
        }
        let mut options = EncoderOptions::new();
        options.set_attribute_quantization(0, 14);
        options.set_compression_level(compression_level);
        let mut encoder = MeshEncoder::new();
        encoder.set_mesh(mesh);
        let mut buffer = EncoderBuffer::new();
        encoder.encode(&options, &mut buffer).unwrap();
        buffer.data().to_vec()
    }

    /// Returns the positions as a meshopt vertex buffer with a stride of 12 bytes.
    pub fn meshopt_positions(&self) -> Vec<u8> {
        let (bytes, count) = (self.position_bytes(), self.vertex_count());
        // The version of EXT_meshopt_compression.
        let encoding = VertexEncoding::new(0, 2).unwrap();
        encode_vertex_buffer(&bytes, count, 12, encoding, &mut Workspace::default()).unwrap()
    }

    /// Returns the indices as a meshopt index buffer.
    pub fn meshopt_indices(&self) -> Vec<u8> {
        encode_index_buffer(&self.indices, IndexEncoding::default(), &mut Workspace::default()).unwrap()
    }
}

/// A KTX2 file of ETC1S, 64 x 64 texels without alpha in one level: ramps and a disc, made for these tests with the Basis
/// Universal encoder.
pub const ETC1S_64: &[u8] = include_bytes!("../data/etc1s_64.ktx2");

/// Returns a KTX2 file of UASTC in one colour: 4 x 4 texels, and 1 to 3 levels.
pub fn uastc_ktx2(color: [u8; 4], levels: u32) -> Vec<u8> {
    uastc_mosaic([4, 4], levels, |_| color)
}

/// Returns the nearest colour of ETC1 as UASTC stores it: the differential mode, the first table of modifiers, the index of one
/// of its four modifiers, and five bits for each channel.
fn etc1_of(color: [u8; 4]) -> u128 {
    let nearest = |part: u8, modifier: i32| -> (i32, u128) {
        let error = |bits: i32| ((bits << 3 | bits >> 2) + modifier).clamp(0, 255).abs_diff(part.into()) as i32;
        (0..32).map(|bits| (error(bits), bits as u128)).min().unwrap_or_default()
    };
    let with = |index: usize| {
        let parts = [0, 1, 2].map(|i| nearest(color[i], [-8, -2, 2, 8][index]));
        let bits =
            parts.iter().enumerate().fold(1 | (index as u128) << 4, |bits, (i, part)| bits | part.1 << (6 + 5 * i));
        (parts.iter().map(|part| part.0).sum::<i32>(), bits)
    };
    (0..4).map(with).min().unwrap_or_default().1
}

/// Returns a KTX2 file of UASTC with alpha, whose blocks of 4 x 4 texels have one colour each. `color` gets the level, and
/// the column and row of a block.
pub fn uastc_mosaic([width, height]: [u32; 2], levels: u32, color: impl Fn([u32; 3]) -> [u8; 4]) -> Vec<u8> {
    let blocks = |level: u32| [width, height].map(|side| (side >> level).max(1).div_ceil(4));
    let bytes = |level: u32| 16 * u64::from(blocks(level)[0] * blocks(level)[1]);
    let mut file = b"\xabKTX 20\xbb\r\n\x1a\n".to_vec();
    let dfd_bytes = 4 + 24 + 16;
    let dfd_at = 80 + 24 * levels;
    for word in [0, 1, width, height, 0, 0, 1, levels, 0, dfd_at, dfd_bytes, 0, 0, 0, 0, 0, 0] {
        file.extend(word.to_le_bytes());
    }
    let data_at = u64::from((dfd_at + dfd_bytes).next_multiple_of(16));
    let mut level_at = data_at;
    for level in 0..levels {
        for word in [level_at, bytes(level), bytes(level)] {
            file.extend(word.to_le_bytes());
        }
        level_at += bytes(level);
    }
    // A basic data format descriptor: UASTC (166), BT.709, sRGB; blocks of 4 x 4 in 16 bytes; one sample, RGBA.
    file.extend(dfd_bytes.to_le_bytes());
    for word in [0u32, 2 | 40 << 16, 166 | 1 << 8 | 2 << 16, 3 | 3 << 8, 16, 0, 127 << 16 | 3 << 24, 0, 0, u32::MAX] {
        file.extend(word.to_le_bytes());
    }
    file.resize(data_at as usize, 0);
    for level in 0..levels {
        let [columns, rows] = blocks(level);
        for (row, column) in (0..rows * columns).map(|i| (i / columns, i % columns)) {
            // Mode 8 of UASTC: five bits of the mode, then the colour and its form in ETC1.
            let color = color([level, column, row]);
            let mut block = u128::from(0x17u8);
            for (i, part) in color.into_iter().enumerate() {
                block |= u128::from(part) << (5 + 8 * i);
            }
            file.extend((block | etc1_of(color) << 37).to_le_bytes());
        }
    }
    file
}
