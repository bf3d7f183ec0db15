//! [`Buffers`]: the binary chunk of a glb with its buffer views and accessors, compressed by EXT_meshopt_compression or not.
//! Any thread.

use meshoptimizer_rs::Workspace;
use meshoptimizer_rs::codec::{
    IndexEncoding, VertexEncoding, encode_filter_oct, encode_index_buffer, encode_index_sequence, encode_vertex_buffer,
};
use serde_json::{Value, json};

use super::container::container;

/// The extension of compressed views.
pub(super) const MESHOPT: &str = "EXT_meshopt_compression";

const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// The type of an accessor's components, with the number that glTF gives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8 = 5120,
    U8 = 5121,
    I16 = 5122,
    U16 = 5123,
    U32 = 5125,
    F32 = 5126,
}

/// The elements of a vertex attribute.
pub(super) struct Elements<'a> {
    /// glTF's type, such as `VEC3`.
    pub kind: &'static str,
    pub component: Component,
    /// Whole numbers stand for values of 0 to 1, or -1 to 1.
    pub is_normalized: bool,
    /// The bytes from one element to the next, a multiple of 4.
    pub stride: usize,
    pub bytes: &'a [u8],
    pub accuracy: Accuracy,
}

/// The changes that compression may make.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Accuracy {
    Exact,
    /// Normals of three signed bytes and a byte of padding may be stored as points of an octahedron, about half a degree off.
    Octahedral,
}

/// The bytes of a glb so far. One thread.
#[derive(Default)]
pub(super) struct Buffers {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    /// The bytes that all compressed views take once they are decompressed; `None` without compression.
    decompressed: Option<usize>,
    workspace: Workspace,
}

impl Buffers {
    pub fn new(is_compressed: bool) -> Self {
        Self { decompressed: is_compressed.then_some(0), ..Self::default() }
    }

    /// Returns true if a view is compressed.
    pub fn has_compressed(&self) -> bool {
        self.decompressed.is_some_and(|bytes| bytes > 0)
    }

    /// Appends bytes, which begin at a multiple of 8 as property tables need. Returns their offset.
    fn append(&mut self, bytes: &[u8]) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(8), 0);
        let offset = self.binary.len();
        self.binary.extend_from_slice(bytes);
        offset
    }

    /// Adds a view of bytes that no accessor reads. Returns its index.
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.append(bytes);
        self.views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }));
        self.views.len() - 1
    }

    /// Adds a view that is compressed, or a plain one if the encoder refuses the bytes.
    fn coded_view(&mut self, bytes: &[u8], stride: usize, target: u32, mode: Mode) -> usize {
        let count = bytes.len() / stride;
        let plain_stride = (target == ARRAY_BUFFER).then_some(stride);
        let coded = match self.decompressed {
            Some(_) if !bytes.is_empty() => self.encode(bytes, count, stride, mode),
            _ => None,
        };
        let mut view = match coded {
            Some(coded) => {
                let offset = self.append(&coded);
                let start = self.decompressed.unwrap_or(0).next_multiple_of(8);
                self.decompressed = Some(start + bytes.len());
                let mut extension = json!({
                    "buffer": 0, "byteOffset": offset, "byteLength": coded.len(),
                    "byteStride": stride, "count": count, "mode": mode.name(),
                });
                if mode == Mode::Normals {
                    extension["filter"] = "OCTAHEDRAL".into();
                }
                let extensions = json!({ MESHOPT: extension });
                json!({ "buffer": 1, "byteOffset": start, "byteLength": bytes.len(), "extensions": extensions })
            }
            None => {
                let offset = self.append(bytes);
                json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() })
            }
        };
        view["target"] = target.into();
        if let Some(stride) = plain_stride {
            view["byteStride"] = stride.into();
        }
        self.views.push(view);
        self.views.len() - 1
    }

    fn encode(&mut self, bytes: &[u8], count: usize, stride: usize, mode: Mode) -> Option<Vec<u8>> {
        let indices = || -> Vec<u32> {
            match stride {
                2 => bytes.as_chunks().0.iter().map(|bytes| u32::from(u16::from_le_bytes(*bytes))).collect(),
                _ => bytes.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect(),
            }
        };
        let workspace = &mut self.workspace;
        // EXT_meshopt_compression has version 0 of the format of attributes.
        let encoding = VertexEncoding::new(0, 0).ok()?;
        match mode {
            Mode::Attributes => encode_vertex_buffer(bytes, count, stride, encoding, workspace).ok(),
            Mode::Normals => {
                let normals: Vec<f32> = bytes.iter().map(|byte| f32::from(byte.cast_signed()) / 127.0).collect();
                let filtered = encode_filter_oct(count, stride, 8, &normals, workspace).ok()?;
                encode_vertex_buffer(&filtered, count, stride, encoding, workspace).ok()
            }
            Mode::Triangles => encode_index_buffer(&indices(), IndexEncoding::default(), workspace).ok(),
            Mode::Indices => encode_index_sequence(&indices(), IndexEncoding::default(), workspace).ok(),
        }
    }

    /// Adds an attribute of vertices. Returns the index of its accessor.
    pub fn attribute(&mut self, elements: &Elements<'_>) -> usize {
        let Elements { kind, component, is_normalized, stride, bytes, accuracy } = *elements;
        let mode = match accuracy {
            Accuracy::Exact => Mode::Attributes,
            Accuracy::Octahedral => Mode::Normals,
        };
        let view = self.coded_view(bytes, stride, ARRAY_BUFFER, mode);
        let mut accessor = json!({
            "bufferView": view, "componentType": component as u32, "count": bytes.len() / stride, "type": kind,
        });
        if is_normalized {
            accessor["normalized"] = true.into();
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds positions, whose accessor has their bounds. Returns its index.
    pub fn positions(&mut self, positions: &[[f32; 3]]) -> usize {
        let bytes = bytemuck::cast_slice(positions);
        let (component, accuracy) = (Component::F32, Accuracy::Exact);
        let elements = Elements { kind: "VEC3", component, is_normalized: false, stride: 12, bytes, accuracy };
        let accessor = self.attribute(&elements);
        self.set_bounds(accessor, bounds(positions).map(|bound| json!(bound)));
        accessor
    }

    /// Adds the smallest and the largest coordinates to an accessor.
    pub fn set_bounds(&mut self, accessor: usize, [min, max]: [Value; 2]) {
        (self.accessors[accessor]["min"], self.accessors[accessor]["max"]) = (min, max);
    }

    /// Adds indices of a mesh with a number of vertices. Returns the index of their accessor.
    pub fn indices(&mut self, indices: &[u32], vertices: usize, are_triangles: bool) -> usize {
        let mode = if are_triangles { Mode::Triangles } else { Mode::Indices };
        // The largest 16-bit index is reserved for primitive restart.
        let (component, view) = match vertices <= usize::from(u16::MAX) {
            true => {
                let short: Vec<u16> = indices.iter().map(|index| *index as u16).collect();
                (Component::U16, self.coded_view(bytemuck::cast_slice(&short), 2, ELEMENT_ARRAY_BUFFER, mode))
            }
            false => (Component::U32, self.coded_view(bytemuck::cast_slice(indices), 4, ELEMENT_ARRAY_BUFFER, mode)),
        };
        self.accessors.push(json!({
            "bufferView": view, "componentType": component as u32, "count": indices.len(), "type": "SCALAR",
        }));
        self.accessors.len() - 1
    }

    /// Adds buffers, views and accessors to the document, and returns the glb.
    pub fn into_glb(mut self, mut document: Value) -> Vec<u8> {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let mut buffers = vec![json!({ "byteLength": self.binary.len() })];
        if let Some(bytes) = self.decompressed.filter(|bytes| *bytes > 0) {
            buffers.push(json!({ "byteLength": bytes, "extensions": { MESHOPT: { "fallback": true } } }));
        }
        for (name, list) in [("buffers", buffers), ("bufferViews", self.views), ("accessors", self.accessors)] {
            // glTF has no empty lists.
            if !list.is_empty() && (name != "buffers" || !self.binary.is_empty()) {
                document[name] = list.into();
            }
        }
        container(&document, &self.binary)
    }
}

/// Returns the smallest and the largest coordinates.
pub(super) fn bounds(positions: &[[f32; 3]]) -> [[f32; 3]; 2] {
    let fold = |start: f32, pick: fn(f32, f32) -> f32| {
        positions.iter().fold([start; 3], |b, p| [pick(b[0], p[0]), pick(b[1], p[1]), pick(b[2], p[2])])
    };
    [fold(f32::INFINITY, f32::min), fold(f32::NEG_INFINITY, f32::max)]
}

/// The mode of a compressed view.
#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Attributes,
    /// Attributes with the octahedral filter.
    Normals,
    Triangles,
    Indices,
}

impl Mode {
    fn name(self) -> &'static str {
        match self {
            Self::Attributes | Self::Normals => "ATTRIBUTES",
            Self::Triangles => "TRIANGLES",
            Self::Indices => "INDICES",
        }
    }
}
