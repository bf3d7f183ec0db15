//! Writes a minimal glb: one mesh, one material, at most one embedded image (glTF 2.0, section "GLB File Format",
//! KHR_mesh_quantization and EXT_meshopt_compression).

use serde_json::{Value, json};

use super::meshopt::{Compression, compress};

/// A triangle mesh in the conventions of glTF: y-up, counter-clockwise.
#[derive(Clone, Debug, Default)]
pub struct GlbMesh {
    /// Positions in metres, y-up.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals; empty for none.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, origin upper left; empty for none.
    pub uvs: Vec<[f32; 2]>,
    /// Vertex indices, three per triangle.
    pub indices: Vec<u16>,
    /// The file of the base colour texture: JPEG, PNG, WebP (EXT_texture_webp) or KTX2 (KHR_texture_basisu).
    pub image: Option<Vec<u8>>,
    /// Linear factor of the base colour.
    pub base_color: [f32; 4],
    /// Writes 16 instead of 32 bytes per vertex with KHR_mesh_quantization. Positions have steps of 1/65,535 of the longest side
    /// of the bounding box, which the node's scale converts to metres. Normals have 8 bits, texture coordinates 16 bits.
    /// Texture coordinates outside of 0..1 stay floats. So does everything in a mesh without positions or with positions that
    /// are not finite.
    pub quantized: bool,
}

// Component types of accessors.
const BYTE: u32 = 5120;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;

/// Returns the smallest and the largest coordinates.
fn bounds(positions: &[[f32; 3]]) -> [[f32; 3]; 2] {
    let fold = |start: f32, pick: fn(f32, f32) -> f32| {
        positions.iter().fold([start; 3], |b, p| [pick(b[0], p[0]), pick(b[1], p[1]), pick(b[2], p[2])])
    };
    [fold(f32::INFINITY, f32::min), fold(f32::NEG_INFINITY, f32::max)]
}

/// Quantizes coordinates to 16 bits: `low` becomes 0, and `low + side` becomes 65,535.
struct Grid {
    low: [f32; 3],
    side: f32,
}

impl Grid {
    /// Returns `None` for a mesh that is not quantized.
    fn of(mesh: &GlbMesh) -> Option<Self> {
        if !mesh.quantized || mesh.positions.is_empty() || !mesh.positions.as_flattened().iter().all(|x| x.is_finite())
        {
            return None;
        }
        let [low, high] = bounds(&mesh.positions);
        let side = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max);
        side.is_finite().then_some(Self { low, side: if side > 0.0 { side } else { 1.0 } })
    }

    /// Returns the quantized position, padded to a multiple of 4 bytes.
    fn steps(&self, position: &[f32; 3]) -> [u16; 4] {
        let [x, y, z] = [0, 1, 2].map(|k| unorm16((position[k] - self.low[k]) / self.side));
        [x, y, z, 0]
    }
}

fn unorm16(x: f32) -> u16 {
    (x * 65535.0).round() as u16
}

fn snorm8(x: f32) -> i8 {
    (x * 127.0).round() as i8
}

/// Returns the MIME type of an image file, and the extension that a texture of it needs.
fn image_kind(file: &[u8]) -> (&'static str, Option<&'static str>) {
    match file {
        [0x89, b'P', b'N', b'G', ..] => ("image/png", None),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => ("image/webp", Some("EXT_texture_webp")),
        [0xab, b'K', b'T', b'X', b' ', b'2', ..] => ("image/ktx2", Some("KHR_texture_basisu")),
        _ => ("image/jpeg", None),
    }
}

/// The buffer views of a file and their bytes.
struct Views {
    views: Vec<Value>,
    binary: Vec<u8>,
    /// Compresses attributes and indices.
    compressed: bool,
    /// The bytes of the compressed views after decompression, at multiples of 4.
    decompressed: usize,
}

impl Views {
    /// Adds the bytes at a multiple of 4 and returns where they begin.
    fn append(&mut self, bytes: &[u8]) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let at = self.binary.len();
        self.binary.extend_from_slice(bytes);
        at
    }

    /// Adds a view of an image and returns its index.
    fn image(&mut self, bytes: &[u8]) -> usize {
        let at = self.append(bytes);
        self.views.push(json!({ "buffer": 0, "byteOffset": at, "byteLength": bytes.len() }));
        self.views.len() - 1
    }

    /// Adds a view of elements of one size and returns its index. Views of attributes name their stride.
    fn elements(&mut self, bytes: &[u8], target: u32, compression: Compression) -> usize {
        let packed = if self.compressed { compress(bytes, compression) } else { None };
        let mut view = json!({ "byteLength": bytes.len(), "target": target });
        if let Compression::Attributes { stride } | Compression::Normals { stride } = compression {
            view["byteStride"] = stride.into();
        }
        match packed {
            Some(packed) => {
                let mut extension = compression.properties(bytes.len());
                (extension["buffer"], extension["byteLength"]) = (0.into(), packed.len().into());
                extension["byteOffset"] = self.append(&packed).into();
                (view["buffer"], view["byteOffset"]) = (1.into(), self.decompressed.into());
                view["extensions"] = json!({ "EXT_meshopt_compression": extension });
                self.decompressed += bytes.len().next_multiple_of(4);
            }
            None => (view["buffer"], view["byteOffset"]) = (0.into(), self.append(bytes).into()),
        }
        self.views.push(view);
        self.views.len() - 1
    }
}

/// Returns the bytes of a glb file. Chunks are padded to 4 bytes, and the position accessor has the bounds that glTF requires.
pub fn write_glb(mesh: &GlbMesh) -> Vec<u8> {
    write(mesh, false)
}

/// Like [`write_glb`], with vertices and indices compressed by EXT_meshopt_compression, which readers must support. The normals
/// of a quantized mesh are off by about half a degree more. [`GlbMesh::optimize_order`] before makes the file smaller.
pub fn write_compressed_glb(mesh: &GlbMesh) -> Vec<u8> {
    write(mesh, true)
}

fn write(mesh: &GlbMesh, compressed: bool) -> Vec<u8> {
    let mut views = Views { views: Vec::new(), binary: Vec::new(), compressed, decompressed: 0 };
    let mut accessors = Vec::new();
    let mut attributes = serde_json::Map::new();
    // Strides are multiples of 4 bytes, as glTF requires.
    let mut attribute = |name: &str, kind: &str, component: u32, stride: usize, bytes: &[u8]| {
        let compression = match (name, component) {
            ("NORMAL", BYTE) => Compression::Normals { stride },
            _ => Compression::Attributes { stride },
        };
        let index = views.elements(bytes, 34962, compression);
        attributes.insert(name.into(), accessors.len().into());
        accessors.push(json!({
            "bufferView": index, "componentType": component, "count": bytes.len() / stride, "type": kind,
        }));
        if let Some(last) = accessors.last_mut().filter(|_| component != FLOAT) {
            last["normalized"] = true.into();
        }
    };
    let grid = Grid::of(mesh);
    let [min, max] = match &grid {
        Some(grid) => {
            let steps: Vec<[u16; 4]> = mesh.positions.iter().map(|p| grid.steps(p)).collect();
            attribute("POSITION", "VEC3", UNSIGNED_SHORT, 8, bytemuck::cast_slice(&steps));
            let bound = |pick: fn(u16, u16) -> u16| {
                let of_all = steps.iter().copied().reduce(|a, b| std::array::from_fn(|k| pick(a[k], b[k])));
                json!(of_all.unwrap_or_default()[..3])
            };
            [bound(u16::min), bound(u16::max)]
        }
        None => {
            attribute("POSITION", "VEC3", FLOAT, 12, bytemuck::cast_slice(&mesh.positions));
            bounds(&mesh.positions).map(|bound| json!(bound))
        }
    };
    if !mesh.normals.is_empty() {
        if grid.is_some() {
            let padded: Vec<[i8; 4]> =
                mesh.normals.iter().map(|n| n.map(snorm8)).map(|[x, y, z]| [x, y, z, 0]).collect();
            attribute("NORMAL", "VEC3", BYTE, 4, bytemuck::cast_slice(&padded));
        } else {
            attribute("NORMAL", "VEC3", FLOAT, 12, bytemuck::cast_slice(&mesh.normals));
        }
    }
    if !mesh.uvs.is_empty() {
        if grid.is_some() && mesh.uvs.as_flattened().iter().all(|x| (0.0..=1.0).contains(x)) {
            let steps: Vec<[u16; 2]> = mesh.uvs.iter().map(|uv| uv.map(unorm16)).collect();
            attribute("TEXCOORD_0", "VEC2", UNSIGNED_SHORT, 4, bytemuck::cast_slice(&steps));
        } else {
            attribute("TEXCOORD_0", "VEC2", FLOAT, 8, bytemuck::cast_slice(&mesh.uvs));
        }
    }
    accessors[0]["min"] = min;
    accessors[0]["max"] = max;
    // The largest 16-bit index is reserved for primitive restart.
    let long: Vec<u32> = match mesh.indices.contains(&u16::MAX) {
        true => mesh.indices.iter().copied().map(u32::from).collect(),
        false => Vec::new(),
    };
    let (component, bytes) = match long.is_empty() {
        true => (UNSIGNED_SHORT, bytemuck::cast_slice(&mesh.indices)),
        false => (UNSIGNED_INT, bytemuck::cast_slice(&long)),
    };
    let size = bytes.len() / mesh.indices.len().max(1);
    let index = views.elements(bytes, 34963, Compression::Triangles { size });
    let indices = accessors.len();
    accessors.push(
        json!({ "bufferView": index, "componentType": component, "count": mesh.indices.len(), "type": "SCALAR" }),
    );
    let mut pbr = json!({ "metallicFactor": 0.0, "roughnessFactor": 1.0, "baseColorFactor": mesh.base_color });
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "terrane" },
        "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] }],
    });
    let mut extensions = Vec::new();
    if let Some(Grid { low, side }) = grid {
        root["nodes"][0]["translation"] = json!(low);
        root["nodes"][0]["scale"] = json!([side, side, side]);
        extensions.push("KHR_mesh_quantization");
    }
    if views.decompressed > 0 {
        extensions.push("EXT_meshopt_compression");
    }
    if let Some(image) = &mesh.image {
        let (mime, extension) = image_kind(image);
        root["images"] = json!([{ "bufferView": views.image(image), "mimeType": mime }]);
        root["samplers"] = json!([{ "magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071 }]);
        root["textures"] = json!([match extension {
            Some(name) => json!({ "sampler": 0, "extensions": { name: { "source": 0 } } }),
            None => json!({ "source": 0, "sampler": 0 }),
        }]);
        extensions.extend(extension);
        pbr["baseColorTexture"] = json!({ "index": 0 });
    }
    if !extensions.is_empty() {
        (root["extensionsUsed"], root["extensionsRequired"]) = (json!(extensions), json!(extensions));
    }
    root["materials"] = json!([{ "pbrMetallicRoughness": pbr }]);
    root["accessors"] = accessors.into();
    let Views { views, mut binary, decompressed, .. } = views;
    root["bufferViews"] = views.into();
    binary.resize(binary.len().next_multiple_of(4), 0);
    root["buffers"] = json!([{ "byteLength": binary.len() }]);
    if decompressed > 0 {
        // Its bytes exist only after decompression.
        let fallback = json!({ "EXT_meshopt_compression": { "fallback": true } });
        root["buffers"] = json!([root["buffers"][0], { "byteLength": decompressed, "extensions": fallback }]);
    }
    container(&root, &binary)
}

/// Returns a glb file of a document and its binary chunk, which is left out if it is empty. The length of the chunk is a multiple
/// of 4.
pub fn container(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary_length = if binary.is_empty() { 0 } else { 8 + binary.len() };
    let length = 12 + 8 + text.len() + binary_length;
    let mut out = Vec::with_capacity(length);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&(length as u32).to_le_bytes());
    out.extend_from_slice(&(text.len() as u32).to_le_bytes());
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&text);
    if !binary.is_empty() {
        out.extend_from_slice(&(binary.len() as u32).to_le_bytes());
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(binary);
    }
    out
}
