//! EXT_meshopt_compression and KHR_meshopt_compression: compressed buffer views.
//!
//! The extension's object is bounded by the view that it replaces before the decoder is called.

use meshoptimizer_rs::{Error, Limits, Workspace, codec};
use serde_json::{Map, Value};

/// The extensions, which have the same properties. KHR adds a filter and a version of the bit stream.
const EXTENSIONS: [&str; 2] = ["KHR_meshopt_compression", "EXT_meshopt_compression"];
/// The maximum size of a compressed vertex.
const MAX_STRIDE: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Filter {
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// A compressed buffer view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CompressedView {
    /// The index of the buffer with the compressed bytes.
    pub buffer: usize,
    pub offset: usize,
    /// The number of compressed bytes.
    pub length: usize,
    /// Bytes of a decoded element.
    stride: usize,
    count: usize,
    mode: Mode,
    filter: Filter,
}

impl CompressedView {
    /// Returns true if the view has one of the extensions.
    pub fn is_compressed(view: &gltf::buffer::View<'_>) -> bool {
        EXTENSIONS.iter().any(|name| view.extension_value(name).is_some())
    }

    /// Reads the extension of a view; `None` if it is not compressed. The error says which property is invalid.
    pub fn new(view: &gltf::buffer::View<'_>) -> Result<Option<Self>, String> {
        let extension = EXTENSIONS.iter().find_map(|name| view.extension_value(name));
        let Some(extension) = extension else { return Ok(None) };
        let properties = extension.as_object().ok_or("meshopt compression is no object")?;
        Self::from_properties(properties, view.length()).map(Some)
    }

    fn from_properties(properties: &Map<String, Value>, view_bytes: usize) -> Result<Self, String> {
        let number = |name: &str| properties.get(name).and_then(Value::as_u64).and_then(|n| usize::try_from(n).ok());
        let bad = |name: &str| format!("meshopt compression: {name} is missing or invalid");
        let needed = |name: &str| number(name).ok_or_else(|| bad(name));
        let text = |name: &str| properties.get(name).and_then(Value::as_str);
        let mode = match text("mode") {
            Some("ATTRIBUTES") => Mode::Attributes,
            Some("TRIANGLES") => Mode::Triangles,
            Some("INDICES") => Mode::Indices,
            _ => return Err(bad("mode")),
        };
        let filter = match text("filter") {
            None | Some("NONE") => Filter::None,
            Some("OCTAHEDRAL") => Filter::Octahedral,
            Some("QUATERNION") => Filter::Quaternion,
            Some("EXPONENTIAL") => Filter::Exponential,
            Some("COLOR") => Filter::Color,
            Some(_) => return Err(bad("filter")),
        };
        let offset = if properties.contains_key("byteOffset") { needed("byteOffset")? } else { 0 };
        let view = Self {
            buffer: needed("buffer")?,
            offset,
            length: needed("byteLength")?,
            stride: needed("byteStride")?,
            count: needed("count")?,
            mode,
            filter,
        };
        let is_stride = match mode {
            Mode::Attributes => (4..=MAX_STRIDE).contains(&view.stride) && view.stride.is_multiple_of(4),
            Mode::Triangles | Mode::Indices => view.stride == 2 || view.stride == 4,
        };
        let suits_filter = match filter {
            Filter::None => true,
            Filter::Octahedral | Filter::Color => view.stride == 4 || view.stride == 8,
            Filter::Quaternion => view.stride == 8,
            Filter::Exponential => view.stride.is_multiple_of(4),
        };
        if !is_stride || !suits_filter || (mode != Mode::Attributes && filter != Filter::None) {
            return Err(bad("byteStride"));
        }
        // The view says how many bytes its readers may use.
        let decoded = view.count.checked_mul(view.stride).ok_or_else(|| bad("count"))?;
        if decoded < view_bytes || decoded > view_bytes.saturating_add(MAX_STRIDE) {
            return Err(format!("meshopt compression: {decoded} bytes for a bufferView of {view_bytes}"));
        }
        if mode == Mode::Triangles && !view.count.is_multiple_of(3) {
            return Err(bad("count"));
        }
        Ok(view)
    }

    /// Returns the number of bytes after decompression.
    pub fn decoded_bytes(&self) -> usize {
        self.count * self.stride
    }
}

impl CompressedView {
    /// Decompresses the view. The caller has counted [`Self::decoded_bytes`].
    pub fn decode(&self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        let Self { stride, count, mode, filter, .. } = *self;
        if count == 0 {
            return Ok(Vec::new());
        }
        let bad = |e: Error| format!("meshopt compression: {e}");
        let decoded = self.decoded_bytes();
        let limits = Limits { max_bytes: decoded.saturating_mul(4).saturating_add(1 << 20), ..Limits::default() };
        let mut workspace = Workspace::new(limits);
        // The decoders of the raw streams: the one for EXT views refuses the newer streams of KHR.
        let mut data = match mode {
            Mode::Attributes => codec::decode_vertex_buffer(count, stride, bytes, &mut workspace),
            Mode::Triangles => codec::decode_index_buffer(count, stride, bytes, &mut workspace),
            Mode::Indices => codec::decode_index_sequence(count, stride, bytes, &mut workspace),
        }
        .map_err(bad)?;
        let apply: fn(&mut [u8], usize, usize, &mut Workspace) -> Result<(), Error> = match filter {
            Filter::None => return Ok(data),
            Filter::Octahedral => codec::decode_filter_oct,
            Filter::Quaternion => codec::decode_filter_quat,
            Filter::Exponential => codec::decode_filter_exp,
            Filter::Color => codec::decode_filter_color,
        };
        let unfiltered = data.clone();
        if apply(&mut data, count, stride, &mut workspace).is_err() {
            // An element without a value, such as a normal of length 0, becomes zero.
            data = unfiltered;
            for element in data.chunks_exact_mut(stride) {
                if apply(element, 1, stride, &mut workspace).is_err() {
                    element.fill(0);
                }
            }
        }
        Ok(data)
    }
}
