//! Writes a minimal glb: one mesh, one material, embedded images of its colour and its normals (glTF 2.0, section "GLB File
//! Format", KHR_mesh_quantization, KHR_texture_transform and EXT_meshopt_compression). Any thread.

use glam::DMat4;
use serde_json::{Value, json};

use super::buffers::{Accuracy, Buffers, Component, Elements, MESHOPT, bounds};

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
    /// The map of normals, which uses the texture coordinates.
    pub normal_map: Option<GlbNormalMap>,
    /// Linear factor of the base colour.
    pub base_color: [f32; 4],
    /// The roughness of the surface, which is no metal.
    pub roughness: GlbRoughness,
    /// Writes 16 instead of 32 bytes per vertex with KHR_mesh_quantization. Positions have steps of 1/65,535 of the longest side
    /// of the bounding box, which the node's scale converts to metres. Normals and tangents have 8 bits, texture coordinates 16
    /// bits. Texture coordinates outside of 0..1 stay floats. So does everything in a mesh without positions or with positions
    /// that are not finite.
    pub quantized: bool,
    /// Maps the mesh to the frame of the file, which is y-up too; `None` for the same frame.
    pub file_from_mesh: Option<DMat4>,
}

/// The roughness of a [`GlbMesh`].
#[derive(Clone, Debug, Default, PartialEq)]
pub enum GlbRoughness {
    /// Rough everywhere, as the ground.
    #[default]
    Rough,
    /// The same everywhere, from 0 (a mirror) to 1 (rough).
    Even(f32),
    /// The file of an image whose green is the roughness. It uses the texture coordinates.
    Map(Vec<u8>),
}

/// The normal map of a [`GlbMesh`].
#[derive(Clone, Debug, Default)]
pub struct GlbNormalMap {
    /// The file of the image, of the same formats as that of the base colour: red along the tangent, green against v.
    pub image: Vec<u8>,
    /// The unit tangent of each vertex, along u, and 1 or -1: the bitangent is the cross product of normal and tangent, times
    /// that. Empty if readers shall derive them.
    pub tangents: Vec<[f32; 4]>,
    /// The image is read at `uv * uv_scale + uv_offset` (KHR_texture_transform).
    pub uv_scale: [f32; 2],
    /// See [`Self::uv_scale`].
    pub uv_offset: [f32; 2],
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

/// Rounds to the nearest step, as conversions cut off. The function `round` would be a call.
fn unorm16(x: f32) -> u16 {
    (x * 65535.0 + 0.5) as u16
}

fn snorm8(x: f32) -> i8 {
    (x * 127.0 + 0.5f32.copysign(x)) as i8
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
    let mut buffers = Buffers::new(compressed);
    let grid = Grid::of(mesh);
    let attributes = vertex_attributes(mesh, grid.as_ref(), &mut buffers);
    let indices: Vec<u32> = mesh.indices.iter().copied().map(u32::from).collect();
    let indices = buffers.indices(&indices, mesh.positions.len(), true);
    let roughness = if let GlbRoughness::Even(roughness) = mesh.roughness { roughness } else { 1.0 };
    let mut pbr = json!({ "metallicFactor": 0.0, "roughnessFactor": roughness, "baseColorFactor": mesh.base_color });
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "terrane" },
        "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] }],
    });
    let mut extensions = Vec::new();
    if let Some(Grid { low, side }) = grid {
        match mesh.file_from_mesh {
            None => {
                root["nodes"][0]["translation"] = json!(low);
                root["nodes"][0]["scale"] = json!([side, side, side]);
            }
            // One matrix of both would round the axes of a large tile, so that they are not at right angles.
            Some(map) => {
                let mesh = json!({ "mesh": 0, "translation": low, "scale": [side, side, side] });
                root["nodes"] = json!([{ "matrix": map.to_cols_array(), "children": [1] }, mesh]);
            }
        }
        extensions.push("KHR_mesh_quantization");
    } else if let Some(map) = mesh.file_from_mesh {
        root["nodes"][0]["matrix"] = json!(map.to_cols_array());
    }
    extensions.extend(buffers.has_compressed().then_some(MESHOPT));
    let mut images = Images::default();
    if let Some(image) = &mesh.image {
        pbr["baseColorTexture"] = json!({ "index": images.add(image, &mut buffers, &mut extensions) });
    }
    if let GlbRoughness::Map(map) = &mesh.roughness {
        pbr["metallicRoughnessTexture"] = json!({ "index": images.add(map, &mut buffers, &mut extensions) });
    }
    let mut material = json!({ "pbrMetallicRoughness": pbr });
    let mut optional = None;
    if let Some(map) = &mesh.normal_map {
        let mut info = json!({ "index": images.add(&map.image, &mut buffers, &mut extensions) });
        if (map.uv_scale, map.uv_offset) != ([1.0; 2], [0.0; 2]) {
            info["extensions"] = json!({ TRANSFORM: { "scale": map.uv_scale, "offset": map.uv_offset } });
            optional = Some(TRANSFORM);
        }
        material["normalTexture"] = info;
    }
    if !images.textures.is_empty() {
        root["samplers"] = json!([{ "magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071 }]);
        (root["images"], root["textures"]) = (images.images.into(), images.textures.into());
    }
    if !extensions.is_empty() {
        root["extensionsRequired"] = json!(extensions);
    }
    extensions.extend(optional);
    if !extensions.is_empty() {
        root["extensionsUsed"] = json!(extensions);
    }
    root["materials"] = json!([material]);
    buffers.into_glb(root)
}

/// The transform of texture coordinates. Readers without it show a map up to half a texel off.
const TRANSFORM: &str = "KHR_texture_transform";

/// The images of a file, with one texture for each.
#[derive(Default)]
struct Images {
    images: Vec<Value>,
    textures: Vec<Value>,
}

impl Images {
    /// Adds the file of an image and the extension that it needs. Returns the index of its texture.
    fn add(&mut self, file: &[u8], buffers: &mut Buffers, extensions: &mut Vec<&'static str>) -> usize {
        let (mime, extension) = image_kind(file);
        let source = self.images.len();
        self.images.push(json!({ "bufferView": buffers.view(file), "mimeType": mime }));
        self.textures.push(match extension {
            Some(name) => json!({ "sampler": 0, "extensions": { name: { "source": source } } }),
            None => json!({ "source": source, "sampler": 0 }),
        });
        extensions.extend(extension.filter(|name| !extensions.contains(name)));
        source
    }
}

/// Adds the attributes of vertices to the buffers. Returns the accessors by the names of attributes.
fn vertex_attributes(mesh: &GlbMesh, grid: Option<&Grid>, buffers: &mut Buffers) -> serde_json::Map<String, Value> {
    let mut attributes = serde_json::Map::new();
    // Strides are multiples of 4 bytes, as glTF requires.
    let positions = match grid {
        Some(grid) => {
            let steps: Vec<[u16; 4]> = mesh.positions.iter().map(|p| grid.steps(p)).collect();
            let accessor = buffers.attribute(&elements("VEC3", Component::U16, 8, bytemuck::cast_slice(&steps)));
            let bound = |pick: fn(u16, u16) -> u16| {
                let of_all = steps.iter().copied().reduce(|a, b| std::array::from_fn(|k| pick(a[k], b[k])));
                json!(of_all.unwrap_or_default()[..3])
            };
            buffers.set_bounds(accessor, [bound(u16::min), bound(u16::max)]);
            accessor
        }
        None => buffers.positions(&mesh.positions),
    };
    attributes.insert("POSITION".into(), positions.into());
    if !mesh.normals.is_empty() {
        let accessor = if grid.is_some() {
            let padded: Vec<[i8; 4]> =
                mesh.normals.iter().map(|n| n.map(snorm8)).map(|[x, y, z]| [x, y, z, 0]).collect();
            let elements = elements("VEC3", Component::I8, 4, bytemuck::cast_slice(&padded));
            buffers.attribute(&Elements { accuracy: Accuracy::Octahedral, ..elements })
        } else {
            buffers.attribute(&elements("VEC3", Component::F32, 12, bytemuck::cast_slice(&mesh.normals)))
        };
        attributes.insert("NORMAL".into(), accessor.into());
    }
    if let Some(map) = mesh.normal_map.as_ref().filter(|map| !map.tangents.is_empty()) {
        let accessor = if grid.is_some() {
            let steps: Vec<[i8; 4]> = map.tangents.iter().map(|t| t.map(snorm8)).collect();
            buffers.attribute(&elements("VEC4", Component::I8, 4, bytemuck::cast_slice(&steps)))
        } else {
            buffers.attribute(&elements("VEC4", Component::F32, 16, bytemuck::cast_slice(&map.tangents)))
        };
        attributes.insert("TANGENT".into(), accessor.into());
    }
    if !mesh.uvs.is_empty() {
        let accessor = if grid.is_some() && mesh.uvs.as_flattened().iter().all(|x| (0.0..=1.0).contains(x)) {
            let steps: Vec<[u16; 2]> = mesh.uvs.iter().map(|uv| uv.map(unorm16)).collect();
            buffers.attribute(&elements("VEC2", Component::U16, 4, bytemuck::cast_slice(&steps)))
        } else {
            buffers.attribute(&elements("VEC2", Component::F32, 8, bytemuck::cast_slice(&mesh.uvs)))
        };
        attributes.insert("TEXCOORD_0".into(), accessor.into());
    }
    attributes
}

/// Returns elements, of which those of whole numbers are normalized.
fn elements<'a>(kind: &'static str, component: Component, stride: usize, bytes: &'a [u8]) -> Elements<'a> {
    let is_normalized = component != Component::F32;
    Elements { kind, component, is_normalized, stride, bytes, accuracy: Accuracy::Exact }
}
