//! [`GltfBuilder`]: small glTF documents for tests, with one embedded buffer.

use base64::Engine as _;
use serde_json::{Value, json};
use terrane::fetch::{IoError, Limits};
use terrane::formats::{Content, Fetched, Ignored, ReadOptions, decode_noting};
use terrane::scene::{Drawable, Geometry, Mesh, Node, NodeKind};

pub const BYTE: u32 = 5120;
pub const UNSIGNED_BYTE: u32 = 5121;
pub const SHORT: u32 = 5122;
pub const UNSIGNED_SHORT: u32 = 5123;
pub const UNSIGNED_INT: u32 = 5125;
pub const FLOAT: u32 = 5126;

/// The address of the documents.
pub const URI: &str = "/set/tile.gltf";

/// A glTF that is being built.
pub struct GltfBuilder {
    pub json: Value,
    pub buffer: Vec<u8>,
}

impl GltfBuilder {
    pub fn new() -> Self {
        let json = json!({ "asset": { "version": "2.0" }, "accessors": [], "bufferViews": [] });
        Self { json, buffer: Vec::new() }
    }

    /// Appends an object to a list of the document and returns its index.
    pub fn push(&mut self, list: &str, object: Value) -> usize {
        let list = &mut self.json[list];
        if list.is_null() {
            *list = json!([]);
        }
        let list = list.as_array_mut().unwrap();
        list.push(object);
        list.len() - 1
    }

    /// Adds a view of new bytes.
    pub fn view(&mut self, bytes: &[u8], stride: Option<usize>) -> usize {
        self.buffer.resize(self.buffer.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.buffer.len(), "byteLength": bytes.len() });
        if let Some(stride) = stride {
            view["byteStride"] = stride.into();
        }
        self.buffer.extend(bytes);
        self.push("bufferViews", view)
    }

    /// Adds an accessor of a new view.
    pub fn accessor(&mut self, component: u32, kind: &str, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes, None);
        self.push("accessors", json!({ "bufferView": view, "componentType": component, "count": count, "type": kind }))
    }

    pub fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let components = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        self.accessor(FLOAT, kind, values.len() / components, &floats(values))
    }

    /// Adds a mesh of one primitive, a node that draws it, and a scene with the node.
    pub fn draw(&mut self, primitive: Value) -> usize {
        let mesh = self.push("meshes", json!({ "primitives": [primitive] }));
        let node = self.push("nodes", json!({ "mesh": mesh }));
        self.json["scenes"] = json!([{ "nodes": [node] }]);
        self.json["scene"] = 0.into();
        node
    }

    /// Returns the document with its buffer as a `data:` URI.
    pub fn text(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json["buffers"].is_null() {
            let uri = data_uri(&self.buffer);
            json["buffers"] = json!([{ "byteLength": self.buffer.len(), "uri": uri }]);
        }
        json.to_string().into_bytes()
    }

    /// Returns the document as a glb.
    pub fn glb(&self) -> Vec<u8> {
        let json = self.text();
        let padded = json.len().next_multiple_of(4);
        let mut glb = b"glTF".to_vec();
        for word in [2, 20 + padded as u32, padded as u32] {
            glb.extend(word.to_le_bytes());
        }
        glb.extend(b"JSON");
        glb.extend(&json);
        glb.resize(20 + padded, b' ');
        glb
    }

    /// Reads the document.
    pub fn read(&self) -> Read {
        read(self.text(), Vec::new()).unwrap()
    }

    /// Returns the reason why the document cannot be read.
    pub fn error(&self) -> String {
        read(self.text(), Vec::new()).map(|_| ()).unwrap_err().reason()
    }
}

/// A glTF that was read.
#[derive(Debug)]
pub struct Read {
    pub node: Node,
    pub ignored: Ignored,
}

impl Read {
    /// Returns all drawables with the transform from their frame to that of the result, y-up as in the file.
    pub fn drawables(&self) -> Vec<(glam::DAffine3, Drawable)> {
        let NodeKind::Transform(_) = self.node.kind else { panic!("the root rotates") };
        let mut found = Vec::new();
        for child in &self.node.children {
            collect(child, glam::DAffine3::IDENTITY, &mut found);
        }
        found
    }

    /// Returns all drawables of any content.
    pub fn node_drawables(&self) -> Vec<Drawable> {
        let mut found = Vec::new();
        collect(&self.node, glam::DAffine3::IDENTITY, &mut found);
        found.into_iter().map(|(_, drawable)| drawable).collect()
    }

    /// Returns the mesh and the drawable, if there is only one.
    pub fn mesh(&self) -> (std::sync::Arc<Mesh>, Drawable) {
        let mut drawables = self.drawables();
        assert_eq!(drawables.len(), 1);
        let (_, drawable) = drawables.remove(0);
        (mesh_of(&drawable), drawable)
    }

    /// Returns the positions of the only drawable in the frame of the file.
    pub fn positions(&self) -> Vec<[f64; 3]> {
        let drawables = self.drawables();
        assert_eq!(drawables.len(), 1);
        let (map, drawable) = &drawables[0];
        let vertices = mesh_of(drawable).vertices.clone();
        vertices
            .iter()
            .map(|v| map.transform_point3(glam::Vec3::from_array(v.position).as_dvec3()))
            .map(|p| p.to_array().map(|x| (x * 1e4).round() / 1e4))
            .collect()
    }
}

pub fn mesh_of(drawable: &Drawable) -> std::sync::Arc<Mesh> {
    let Geometry::Mesh(mesh) = &drawable.geometry else { panic!("a mesh") };
    mesh.clone()
}

fn collect(node: &Node, above: glam::DAffine3, found: &mut Vec<(glam::DAffine3, Drawable)>) {
    let map = match &node.kind {
        NodeKind::Transform(map) => above * *map,
        _ => above,
    };
    if let NodeKind::Geode(drawables) = &node.kind {
        found.extend(drawables.iter().map(|drawable| (map, drawable.clone())));
    }
    node.children.iter().for_each(|child| collect(child, map, found));
}

/// Reads a content with these companions.
pub fn read(bytes: Vec<u8>, companions: Vec<Fetched>) -> Result<Read, IoError> {
    read_with(bytes, companions, &ReadOptions::for_root("/set/tileset.json", Limits::default()))
}

/// Reads a content with these options.
pub fn read_with(bytes: Vec<u8>, companions: Vec<Fetched>, options: &ReadOptions) -> Result<Read, IoError> {
    let (node, ignored) = decode_noting(Content { uri: URI.into(), bytes, reader_data: None, companions }, options)?;
    Ok(Read { node, ignored })
}

pub fn data_uri(bytes: &[u8]) -> String {
    format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

pub fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

pub fn shorts(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// Returns a PNG of one colour.
pub fn png(side: u32, color: [u8; 3]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(side, side, image::Rgb(color)).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// The corners of a triangle.
pub const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
