//! From the bytes of one content to a page, told apart by magic, never by extension.

use std::sync::Arc;

use glam::DAffine3;

use super::{IoError, Limits, RootScope, b3dm, file, gltf, height, image, pnts, tileset};
use crate::scene::{Node, Page, SharedStateManager};

/// What every read of a tile set shares.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// What references may reach.
    pub root: RootScope,
    /// How much is accepted.
    pub limits: Limits,
    /// URIs of the tilesets above, root first; a tileset among them is a cycle.
    pub chain: Arc<[Arc<str>]>,
    /// Maps what is read to the frame of the whole set: the product of the transforms of the tiles above. Regions, which no
    /// transform moves, need it.
    pub set_from_content: DAffine3,
    /// Pages get a [`KdTree`](crate::scene::KdTree) for each drawable, so that lines and volumes can be intersected with
    /// them after their payloads went to the GPU. Off by default: it costs memory and time of the decode workers.
    pub build_kd_trees: bool,
    /// Attributes of a glTF's primitives that meshes keep under these names beside those of every mesh, for
    /// [`Program`](crate::state::Program)s: `TANGENT`, `TEXCOORD_1`, `_HEAT`. None by default, as they take memory. Matrices
    /// are kept as their columns: `_BASIS_0`, `_BASIS_1` and so on of `_BASIS`. A glTF in which a mesh would have more
    /// than [`MAX_ATTRIBUTES`](crate::scene::MAX_ATTRIBUTES) fails.
    pub vertex_attributes: Arc<[Arc<str>]>,
    /// Shares what is equal between contents; `None` by default. A pager has one of its own.
    pub sharing: Option<Arc<SharedStateManager>>,
}

impl ReadOptions {
    /// Options for a tile set whose root is `root_uri`, as [`super::root_uri`] returned it.
    pub fn for_root(root_uri: &str, limits: Limits) -> Self {
        Self {
            root: RootScope::of(root_uri),
            limits,
            chain: Arc::new([]),
            set_from_content: DAffine3::IDENTITY,
            build_kd_trees: false,
            vertex_attributes: Arc::default(),
            sharing: None,
        }
    }

    /// The same for what a tileset names.
    pub fn below(&self, tileset_uri: &Arc<str>) -> Self {
        let chain: Vec<Arc<str>> = self.chain.iter().cloned().chain([tileset_uri.clone()]).collect();
        Self { chain: chain.into(), ..self.clone() }
    }
}

/// A URI and the bytes that came from it, or why none did.
pub type Fetched = (Arc<str>, Result<Vec<u8>, IoError>);

/// The bytes of one content and what came with it.
#[derive(Clone, Debug)]
pub struct Content {
    /// Where the bytes came from.
    pub uri: Arc<str>,
    /// As read; gzip is undone here if it was not before.
    pub bytes: Vec<u8>,
    /// What the tileset's reader left for the content's reader.
    pub reader_data: Option<Arc<str>>,
    /// The files that [`companions`] named.
    pub companions: Vec<Fetched>,
}

/// The other URIs that a content needs: a height tile's imagery.
pub fn companions(uri: &Arc<str>, reader_data: Option<&Arc<str>>) -> Vec<Arc<str>> {
    height::companions(uri, reader_data)
}

/// Decodes a content. CPU only, no I/O; any thread.
///
/// The readers do not panic on outside data; should one of the crates behind them do so, that content fails with an
/// error that says so, and nothing else.
pub fn decode(content: Content, options: &ReadOptions) -> Result<Page, IoError> {
    let uri = content.uri.clone();
    let read = || {
        let node = decode_node(content, options)?;
        let mut page = Page::from_node(node).map_err(|e| IoError::invalid(&uri, e.to_string()))?;
        if options.build_kd_trees {
            page.build_kd_trees();
        }
        if let Some(sharing) = &options.sharing {
            sharing.share_states(&mut page);
            page.hold_shared();
        }
        Ok(page)
    };
    guarded(&uri, read)
}

/// Reads outside data; should a crate that helps with it panic, that is an error of this URI, and the thread goes on.
pub(crate) fn guarded<T>(uri: &str, read: impl FnOnce() -> Result<T, IoError>) -> Result<T, IoError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(read))
        .unwrap_or_else(|_| Err(IoError::invalid(uri, DECODER_PANICKED)))
}

/// The reason given for a content whose decoder panicked.
pub const DECODER_PANICKED: &str = "the decoder panicked";

/// [`decode`] before the graph is flattened.
pub fn decode_node(content: Content, options: &ReadOptions) -> Result<Node, IoError> {
    let Content { uri, bytes, reader_data, companions } = content;
    let limits = &options.limits;
    let sharing = options.sharing.as_deref();
    let bytes = file::gunzip(&uri, bytes, limits)?;
    let (text, first) = first_of_text(&bytes);
    if bytes.starts_with(b"glTF") {
        return gltf::read_glb(&uri, &bytes, None, options);
    }
    if bytes.starts_with(b"b3dm") {
        let (glb, center) = b3dm::unwrap(&uri, &bytes)?;
        return gltf::read_glb(&uri, glb, center, options);
    }
    if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return height::read(&uri, &bytes, reader_data.as_deref(), companions, limits, sharing);
    }
    if bytes.starts_with(b"pnts") {
        return pnts::read(&uri, &bytes, limits);
    }
    for (magic, what) in [
        (&b"i3dm"[..], "instanced model (i3dm)"),
        (b"cmpt", "composite tile (cmpt)"),
        (b"subt", "implicit tiling (subtree)"),
        (b"PMTiles", "a whole PMTiles file as the content of a tile"),
    ] {
        if bytes.starts_with(magic) {
            return Err(IoError::unsupported(&uri, what));
        }
    }
    if first == Some(b'{') {
        return if is_tileset_text(&uri, text)? {
            tileset::read(&uri, text, options)
        } else {
            gltf::read_gltf(&uri, text, options)
        };
    }
    refuse_markup(&uri, &bytes)?;
    if image::is_image(&bytes) {
        return Err(IoError::unsupported(&uri, "an image as the content of a tile"));
    }
    Err(IoError::invalid(&uri, format!("unknown magic {:02x?}", bytes.get(..4.min(bytes.len())).unwrap_or(&[]))))
}

/// A tileset rather than a glTF.
fn is_tileset_text(uri: &str, text: &[u8]) -> Result<bool, IoError> {
    #[derive(serde::Deserialize)]
    struct Probe {
        root: Option<serde::de::IgnoredAny>,
        #[serde(rename = "geometricError")]
        geometric_error: Option<serde::de::IgnoredAny>,
    }
    let probe: Probe = serde_json::from_slice(text).map_err(|e| IoError::invalid(uri, format!("JSON: {e}")))?;
    Ok(probe.root.is_some() || probe.geometric_error.is_some())
}

/// True for the bytes of a tileset, whatever it is called.
pub(crate) fn is_tileset(uri: &str, bytes: &[u8], limits: &Limits) -> bool {
    let is_text = |bytes: &[u8]| {
        let (text, first) = first_of_text(bytes);
        first == Some(b'{') && is_tileset_text(uri, text).unwrap_or(false)
    };
    if bytes.starts_with(&[0x1f, 0x8b]) {
        return file::gunzip(uri, bytes.to_vec(), limits).is_ok_and(|bytes| is_text(&bytes));
    }
    is_text(bytes)
}

/// True for names that do not say that they are no tileset's.
#[cfg(feature = "http")]
pub(crate) fn may_be_tileset(uri: &str) -> bool {
    const OTHERS: [&str; 16] = [
        "glb", "gltf", "b3dm", "i3dm", "pnts", "cmpt", "subtree", "exr", "png", "jpg", "jpeg", "webp", "tif", "ktx2",
        "terrain", "bin",
    ];
    let path = uri.split(['?', '#']).next().unwrap_or(uri);
    let extension = path.rsplit('/').next().and_then(|name| name.rsplit_once('.')).map(|(_, extension)| extension);
    extension.is_none_or(|extension| !OTHERS.iter().any(|other| extension.eq_ignore_ascii_case(other)))
}

/// Pages for people begin as no content does.
pub(crate) fn refuse_markup(uri: &str, bytes: &[u8]) -> Result<(), IoError> {
    match first_of_text(bytes).1 {
        Some(b'<') => Err(IoError::Markup { uri: uri.to_owned() }),
        _ => Ok(()),
    }
}

/// Text without its byte order mark, and what it begins with besides white space.
fn first_of_text(bytes: &[u8]) -> (&[u8], Option<u8>) {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    (text, text.iter().find(|b| !b.is_ascii_whitespace()).copied())
}
