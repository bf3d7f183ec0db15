//! A minimal glb: one mesh, one material, at most one embedded image. glTF 2.0, section "GLB File Format".

use serde_json::json;

/// One triangle mesh as glTF wants it: y-up, counter-clockwise, indices below 65,536.
#[derive(Clone, Debug, Default)]
pub struct GlbMesh {
    /// Metres, y-up.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals; empty for none.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, origin upper left; empty for none.
    pub uvs: Vec<[f32; 2]>,
    /// Triangles.
    pub indices: Vec<u16>,
    /// A JPEG or PNG for the base colour.
    pub image: Option<Vec<u8>>,
    /// Linear factor of the base colour.
    pub base_color: [f32; 4],
}

/// The file's bytes. Chunks are padded to 4 bytes, accessors carry the bounds that glTF asks for.
pub fn write_glb(mesh: &GlbMesh) -> Vec<u8> {
    let mut binary: Vec<u8> = Vec::new();
    let mut views = Vec::new();
    let mut accessors = Vec::new();
    let mut attributes = serde_json::Map::new();
    let mut view = |binary: &mut Vec<u8>, bytes: &[u8], target: Option<u32>| {
        binary.resize(binary.len().next_multiple_of(4), 0);
        let mut v = json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            v["target"] = target.into();
        }
        binary.extend_from_slice(bytes);
        views.push(v);
        views.len() - 1
    };
    let bound = |start: f32, pick: fn(f32, f32) -> f32| {
        mesh.positions.iter().fold([start; 3], |b, p| [pick(b[0], p[0]), pick(b[1], p[1]), pick(b[2], p[2])])
    };
    let index = view(&mut binary, bytemuck::cast_slice(&mesh.positions), Some(34962));
    attributes.insert("POSITION".into(), accessors.len().into());
    accessors.push(json!({
        "bufferView": index, "componentType": 5126, "count": mesh.positions.len(), "type": "VEC3",
        "min": bound(f32::INFINITY, f32::min), "max": bound(f32::NEG_INFINITY, f32::max),
    }));
    if !mesh.normals.is_empty() {
        let index = view(&mut binary, bytemuck::cast_slice(&mesh.normals), Some(34962));
        attributes.insert("NORMAL".into(), accessors.len().into());
        accessors.push(json!({
            "bufferView": index, "componentType": 5126, "count": mesh.normals.len(), "type": "VEC3",
        }));
    }
    if !mesh.uvs.is_empty() {
        let index = view(&mut binary, bytemuck::cast_slice(&mesh.uvs), Some(34962));
        attributes.insert("TEXCOORD_0".into(), accessors.len().into());
        accessors.push(json!({ "bufferView": index, "componentType": 5126, "count": mesh.uvs.len(), "type": "VEC2" }));
    }
    let index = view(&mut binary, bytemuck::cast_slice(&mesh.indices), Some(34963));
    let indices = accessors.len();
    accessors
        .push(json!({ "bufferView": index, "componentType": 5123, "count": mesh.indices.len(), "type": "SCALAR" }));
    let mut pbr = json!({ "metallicFactor": 0.0, "roughnessFactor": 1.0, "baseColorFactor": mesh.base_color });
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "terrane" },
        "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] }],
    });
    if let Some(image) = &mesh.image {
        let index = view(&mut binary, image, None);
        let mime = if image.starts_with(b"\x89PNG") { "image/png" } else { "image/jpeg" };
        root["images"] = json!([{ "bufferView": index, "mimeType": mime }]);
        root["samplers"] = json!([{ "magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071 }]);
        root["textures"] = json!([{ "source": 0, "sampler": 0 }]);
        pbr["baseColorTexture"] = json!({ "index": 0 });
    }
    root["materials"] = json!([{ "pbrMetallicRoughness": pbr }]);
    root["bufferViews"] = views.into();
    root["accessors"] = accessors.into();
    binary.resize(binary.len().next_multiple_of(4), 0);
    root["buffers"] = json!([{ "byteLength": binary.len() }]);
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = 12 + 8 + text.len() + 8 + binary.len();
    let mut out = Vec::with_capacity(length);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&(length as u32).to_le_bytes());
    out.extend_from_slice(&(text.len() as u32).to_le_bytes());
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&text);
    out.extend_from_slice(&(binary.len() as u32).to_le_bytes());
    out.extend_from_slice(b"BIN\0");
    out.extend_from_slice(&binary);
    out
}
