//! Decodes the bytes of one content to a page. Formats are recognized by magic bytes, never by file extension, but for
//! quantized-mesh, which has none. Decode threads.

use std::sync::Arc;

use super::gltf::GltfSource;
use super::ignored::{Ignored, Notes};
use super::implicit::{SubtreePart, SubtreeSource};
use super::options::{Content, Fetched, ReadOptions};
use super::terrain::{self, TerrainPage, TerrainTile};
use super::tile::{Body, ContentBytes, ContentData, TileContent, node_of};
use super::{
    b3dm, cmpt, draping, embedded, gltf, height, i3dm, image, implicit, model_files, osg, point_cloud, style, tileset,
};
use crate::fetch::markup::{is_lfs_pointer, refuse_markup, text_and_first_byte};
use crate::fetch::{IoError, about_to_allocate, encoding, guarded, limited};
use crate::scene::{Node, Page, ReaderData, ReaderValue};

/// The maximum number of files that one content may refer to.
const MAX_DEPENDENCIES: usize = 4096;

/// Returns the other URIs that a content needs and that are known before it is read: the imagery of a height tile, or the
/// other contents of a tile and their imagery.
pub fn companions(uri: &Arc<str>, reader_data: Option<&ReaderData>) -> Vec<Arc<str>> {
    if let Some(ContentBytes::Several(contents)) = content_data(reader_data).map(|data| &data.bytes) {
        let mut fetched = contents.iter().filter(|content| !content.is_in_memory());
        // The first is the content itself.
        fetched.next();
        let others = fetched.map(|content| content.uri.clone());
        let text = |content: &TileContent| content.reader_data.as_ref().and_then(ReaderData::text).map(str::to_owned);
        let imagery = contents.iter().flat_map(|content| height::companions(&content.uri, text(content).as_deref()));
        return others.chain(imagery).collect();
    }
    if let Some(page) = value::<TerrainPage>(reader_data) {
        return page.companions();
    }
    height::companions(uri, reader_data.and_then(ReaderData::text))
}

/// Returns the URI at which a companion is looked for if its own has none: the address that was asked for, without redirects.
pub fn companion_fallback(companion: &str, reader_data: Option<&ReaderData>) -> Option<Arc<str>> {
    let ContentBytes::Several(contents) = &content_data(reader_data)?.bytes else { return None };
    let content = contents.iter().find(|content| *content.uri == *companion && !content.is_in_memory())?;
    content.reader_data.as_ref()?.fallback_uri()
}

/// Returns the files that a content refers to and that are not in `known`: external buffers of a subtree, external buffers
/// and images of a glTF, the model of an i3dm, and the schema of a tileset. A loader fetches them after the content, adds
/// them to its companions, and asks again until none is left. References that are not allowed are left out; the decoder
/// reports them. Any thread.
pub fn dependencies(
    uri: &str,
    bytes: &[u8],
    reader_data: Option<&ReaderData>,
    known: &[Fetched],
    options: &ReadOptions,
) -> Vec<Arc<str>> {
    let find = || dependencies_within(uri, bytes, reader_data, known, options);
    // The decoder reports a content that is too large.
    limited(options.limits.max_content_bytes, find).unwrap_or_default()
}

fn dependencies_within(
    uri: &str,
    bytes: &[u8],
    reader_data: Option<&ReaderData>,
    known: &[Fetched],
    options: &ReadOptions,
) -> Vec<Arc<str>> {
    let is_terrain = value::<TerrainPage>(reader_data).is_some() || value::<TerrainTile>(reader_data).is_some();
    let base = options.base.as_deref().unwrap_or(uri);
    let needed = if is_terrain {
        Vec::new()
    } else if let Some(source) = reader_data.and_then(|data| data.value::<SubtreeSource>()) {
        implicit::external_buffers(source, uri, bytes, options)
    } else if let Some(ContentBytes::Several(contents)) = content_data(reader_data).map(|data| &data.bytes) {
        let fetched = contents.iter().filter(|content| !content.is_in_memory()).enumerate();
        let files = fetched.flat_map(|(i, content)| {
            let other = || Some(&known.iter().find(|(fetched, _)| *fetched == content.uri)?.1);
            match (i, other()) {
                (0, _) => model_files::of_model(base, bytes, known, options),
                (_, Some(Ok(bytes))) => {
                    let base = options.companion_base(&content.uri).unwrap_or(&content.uri);
                    model_files::of_model(base, bytes, known, options)
                }
                _ => Vec::new(),
            }
        });
        files.collect()
    } else {
        model_files::of_model(base, bytes, known, options)
    };
    let of_overlays = draping::needed(bytes, reader_data, known, options);
    let mut unknown: Vec<Arc<str>> = Vec::new();
    for dependency in needed.into_iter().take(MAX_DEPENDENCIES).chain(of_overlays) {
        if !known.iter().any(|(fetched, _)| *fetched == dependency) && !unknown.contains(&dependency) {
            unknown.push(dependency);
        }
    }
    unknown
}

/// Returns true if [`dependencies`] may take longer than a thread that serves requests should be held up: for large texts,
/// compressed contents and subtrees, and for the XML documents of map servers among the files that were fetched.
#[cfg(feature = "http")]
pub(crate) fn has_slow_dependencies(bytes: &[u8], known: &[Fetched]) -> bool {
    const MAX_QUICK_BYTES: usize = 64 << 10;
    const QUICK: [&[u8]; 7] =
        [b"glTF", b"b3dm", b"i3dm", b"cmpt", b"pnts", &[0x76, 0x2f, 0x31, 0x01], height::PACKED_MAGIC];
    let is_xml = |bytes: &Vec<u8>| text_and_first_byte(bytes).1 == Some(b'<');
    (bytes.len() > MAX_QUICK_BYTES && !QUICK.iter().any(|magic| bytes.starts_with(magic)))
        || known.iter().any(|(_, file)| file.as_ref().is_ok_and(is_xml))
}

/// Decodes a content to a page. CPU only, no I/O; any thread. What the content asks for and the reader leaves out is added
/// to [`ReadOptions::ignored`].
///
/// If a crate behind a decoder panics, only this content fails, with the reason
/// [`DECODER_PANICKED`](crate::fetch::DECODER_PANICKED).
pub fn decode(content: Content, options: &ReadOptions) -> Result<Page, IoError> {
    let uri = content.uri.clone();
    let read = || {
        let Decoded { node, credits, body, .. } = decode_whole(content, options)?;
        let mut page = Page::from_node(node).map_err(|e| IoError::invalid(&uri, e.to_string()))?;
        page.set_credits(credits);
        page.set_ellipsoid(body.map_or(options.ellipsoid, |body| body.ellipsoid()));
        if options.build_kd_trees {
            page.build_kd_trees();
        }
        if let Some(sharing) = &options.sharing {
            sharing.share_states(&mut page);
            page.hold_shared();
        }
        page.find_vertex_formats();
        Ok(page)
    };
    guarded(&uri, || within_budget(&uri, options, read))
}

/// Decodes a content to nodes: [`decode`] without building a page.
pub fn decode_node(content: Content, options: &ReadOptions) -> Result<Node, IoError> {
    decode_noting(content, options).map(|(node, _)| node)
}

/// Decodes a content to nodes, and returns what the reader left out.
pub fn decode_noting(content: Content, options: &ReadOptions) -> Result<(Node, Ignored), IoError> {
    decode_whole(content, options).map(|decoded| (decoded.node, decoded.ignored))
}

/// A content that was decoded.
pub(super) struct Decoded {
    pub node: Node,
    /// The properties that the reader left out.
    ignored: Ignored,
    /// The attributions of the content and of its overlays.
    pub credits: Vec<Arc<str>>,
    /// The body that a root tileset declares.
    pub body: Option<Body>,
}

/// Decodes a content to nodes with its attributions.
pub(super) fn decode_whole(content: Content, options: &ReadOptions) -> Result<Decoded, IoError> {
    let uri = content.uri.clone();
    within_budget(&uri, options, || decode_all(content, options))
}

/// Runs a decoder that may take [`max_content_bytes`](crate::fetch::Limits::max_content_bytes). A content that asks for more
/// fails, also if its reader would leave out the part that did not fit.
fn within_budget<T>(uri: &str, options: &ReadOptions, read: impl FnOnce() -> Result<T, IoError>) -> Result<T, IoError> {
    limited(options.limits.max_content_bytes, read).unwrap_or_else(|error| Err(error.at(uri)))
}

fn decode_all(content: Content, options: &ReadOptions) -> Result<Decoded, IoError> {
    let notes = Notes::default();
    options.credits.iter().for_each(|credit| notes.add_credit(credit));
    let overlays = draping::Draping::new(&content, options);
    let mut node = match &options.style {
        Some(style) => {
            let with_features = ReadOptions { keep_features: true, ..options.clone() };
            let mut node = read_node(content, &with_features, &notes)?;
            let to = style::Styled {
                set_from_content: options.set_from_content,
                keeps_features: options.keep_features,
                max_elements: options.limits.max_elements,
            };
            style::apply(&mut node, style, to, &notes);
            node
        }
        None => read_node(content, options, &notes)?,
    };
    if let Some(overlays) = overlays {
        overlays.apply(&mut node, options, &notes);
    }
    let (credits, body) = (notes.take_credits(), notes.take_body());
    let ignored = notes.into_ignored();
    options.ignored.add(&ignored);
    Ok(Decoded { node, ignored, credits, body })
}

fn read_node(content: Content, options: &ReadOptions, notes: &Notes) -> Result<Node, IoError> {
    let Content { uri, bytes, reader_data, companions } = content;
    if let Some(part) = reader_data.as_ref().and_then(|data| data.value::<SubtreePart>()) {
        return part.read(options).map(node_of);
    }
    if let Some(source) = reader_data.as_ref().and_then(|data| data.value::<SubtreeSource>()) {
        let bytes = encoding::gunzip(&uri, bytes, &options.limits)?;
        return source.read(&uri, bytes, &companions, options).map(node_of);
    }
    if let Some(part) = reader_data.as_ref().and_then(|data| data.value::<osg::InlinePart>()) {
        return part.read(options, notes);
    }
    if let Some(page) = value::<TerrainPage>(reader_data.as_ref()) {
        return page.read(&uri, bytes, &companions, options).map(node_of);
    }
    if let Some(tile) = value::<TerrainTile>(reader_data.as_ref()) {
        return tile.read(&uri, bytes, options, notes);
    }
    if let Some(below) = value::<osg::TerrainBelow>(reader_data.as_ref()) {
        let bytes = encoding::gunzip(&uri, bytes, &options.limits)?;
        if osg::is_native(&bytes) {
            let base = options.base.as_ref().unwrap_or(&uri);
            return osg::read((&uri, base), &bytes, &companions, Some(below), options, notes);
        }
        return read_bytes(&uri, bytes, None, companions, options, notes);
    }
    let Some(data) = content_data(reader_data.as_ref()) else {
        let text = reader_data.as_ref().and_then(ReaderData::text);
        return read_bytes(&uri, bytes, text, companions, options, notes);
    };
    let options = &ReadOptions { gltf_up_axis: data.up_axis, ..options.clone() };
    match &data.bytes {
        ContentBytes::Fetched => read_bytes(&uri, bytes, None, companions, options, notes),
        ContentBytes::Embedded(reference) => {
            let bytes = embedded::data_uri(&uri, reference)?;
            read_bytes(&uri, bytes, None, companions, options, notes)
        }
        ContentBytes::Refused(error) => Err(error.clone()),
        ContentBytes::Several(contents) => read_several(contents, (uri, Ok(bytes)), companions, options, notes),
    }
}

fn content_data(reader_data: Option<&ReaderData>) -> Option<&ContentData> {
    reader_data?.value()
}

fn value<T: ReaderValue>(reader_data: Option<&ReaderData>) -> Option<&T> {
    reader_data?.value()
}

/// Reads all contents of a tile as one node. `companions` are the other contents, then the files that contents refer to.
fn read_several(
    contents: &[TileContent],
    first: Fetched,
    mut companions: Vec<Fetched>,
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Node, IoError> {
    let fetched_count = contents.iter().filter(|content| !content.is_in_memory()).count();
    let dependencies = companions.split_off(fetched_count.saturating_sub(1).min(companions.len()));
    let mut fetched = std::iter::once(first).chain(companions);
    let mut is_first = true;
    let mut nodes = Vec::with_capacity(contents.len());
    for content in contents {
        let base = &options.base;
        let mut options = ReadOptions { base: None, ..options.clone() };
        let bytes = if content.is_in_memory() {
            Vec::new()
        } else {
            // The first that is fetched is the content itself, the others are its companions.
            options.base = match std::mem::take(&mut is_first) {
                true => base.clone(),
                false => options.companion_base(&content.uri).cloned(),
            };
            let missing = || IoError::NotFound { uri: content.uri.to_string() };
            fetched.next().ok_or_else(missing)?.1?
        };
        // A server said that there is no content.
        if bytes.is_empty() && !content.is_in_memory() {
            continue;
        }
        let TileContent { uri, reader_data, metadata, .. } = content.clone();
        let content = Content { uri, bytes, reader_data, companions: dependencies.clone() };
        nodes.push(Node { metadata, ..read_node(content, &options, notes)? });
    }
    Ok(Node::group(nodes))
}

/// Reads the bytes of a content by their magic. `text` is the reader data of a height tile.
fn read_bytes(
    uri: &Arc<str>,
    bytes: Vec<u8>,
    text: Option<&str>,
    companions: Vec<Fetched>,
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Node, IoError> {
    let bytes = encoding::gunzip(uri, bytes, &options.limits)?;
    if let Some(reader) = options.reader_of(uri, &bytes) {
        about_to_allocate(reader.decoded_bytes(uri, &bytes)).map_err(|error| error.at(uri))?;
        return reader.read(uri, &bytes, &companions, options).map_err(|reason| IoError::invalid(uri, reason));
    }
    if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) || bytes.starts_with(height::PACKED_MAGIC) {
        return height::read(uri, &bytes, text, companions, options, notes);
    }
    ModelReader { uri, companions: &companions, options, notes }.read(&bytes, 0)
}

/// Reads models by their magic.
struct ModelReader<'a> {
    uri: &'a Arc<str>,
    /// The files that the content refers to.
    companions: &'a [Fetched],
    options: &'a ReadOptions,
    notes: &'a Notes,
}

impl ModelReader<'_> {
    /// Returns the address that references are relative to.
    fn base(&self) -> &str {
        self.options.base.as_ref().unwrap_or(self.uri)
    }

    /// Reads a model, or a composite of models inside `depth` others.
    fn read(&self, bytes: &[u8], depth: u32) -> Result<Node, IoError> {
        let Self { uri, companions, options, notes } = *self;
        let (json, first) = text_and_first_byte(bytes);
        let read_gltf = |bytes: &[u8], rtc_center, batch_table| {
            let source = GltfSource { uri, base: self.base(), bytes, rtc_center, batch_table, companions };
            gltf::read(source, options, notes)
        };
        if bytes.starts_with(b"glTF") {
            return read_gltf(bytes, None, None);
        }
        if bytes.starts_with(b"b3dm") {
            let b3dm = b3dm::unwrap(uri, bytes, &options.limits)?;
            let batch_table = options.keep_features.then(|| b3dm.batch_table(&options.limits, notes)).flatten();
            return read_gltf(b3dm.glb, b3dm.rtc_center, batch_table.map(Arc::new));
        }
        if bytes.starts_with(b"i3dm") {
            return i3dm::read((uri, self.base()), bytes, companions, options, notes);
        }
        if osg::is_native(bytes) {
            return osg::read((uri, self.base()), bytes, companions, None, options, notes);
        }
        if osg::is_metadata(bytes) {
            return osg::read_folder((uri, self.base()), bytes, companions, options, notes);
        }
        if bytes.starts_with(b"pnts") {
            return point_cloud::read(uri, bytes, options, notes);
        }
        if bytes.starts_with(b"cmpt") {
            let parts = cmpt::parts(uri, bytes, depth)?;
            let count = parts.len();
            let (mut nodes, mut unsupported) = (Vec::with_capacity(count), None);
            for part in parts {
                match self.read(part, depth + 1) {
                    Ok(node) => nodes.push(node),
                    // Old sets keep vector tiles beside their meshes.
                    Err(error @ IoError::Unsupported { .. }) => {
                        notes.add(format!("cmpt: a tile that is not drawn: {}", error.reason()));
                        unsupported.get_or_insert(error);
                    }
                    Err(error) => return Err(error),
                }
            }
            return match unsupported {
                Some(error) if nodes.is_empty() => Err(error),
                _ => Ok(Node::group(nodes)),
            };
        }
        for (magic, what) in [
            (&b"subt"[..], "a subtree outside of implicit tiling"),
            (b"PMTiles", "a whole PMTiles file as the content of a tile"),
            (b"vctr", "a vector tile (vctr)"),
            (b"geom", "a geometry tile (geom)"),
        ] {
            if bytes.starts_with(magic) {
                return Err(IoError::unsupported(uri, what));
            }
        }
        if terrain::is_tile_name(uri) {
            return terrain::read_alone(uri, bytes, options, notes);
        }
        if first == Some(b'{') {
            return if tileset::is_tileset_text(uri, json)? {
                tileset::read(uri, json, companions, options, notes)
            } else if terrain::is_layer_text(json) {
                terrain::read(uri, json, companions, options)
            } else if is_geojson(json) {
                Err(IoError::unsupported(uri, "GeoJSON"))
            } else {
                read_gltf(json, None, None)
            };
        }
        if terrain::is_tile_name(uri) {
            return terrain::read_alone(uri, bytes, options, notes);
        }
        refuse_markup(uri, bytes)?;
        if image::is_image(bytes) {
            return Err(IoError::unsupported(uri, "an image as the content of a tile"));
        }
        if bytes.is_empty() {
            return Err(IoError::invalid(uri, "the file is empty"));
        }
        if is_lfs_pointer(bytes) {
            return Err(IoError::invalid(
                uri,
                "a pointer of Git LFS instead of the file, which `git lfs pull` fetches",
            ));
        }
        if bytes.starts_with(b"SQLite format 3\0") {
            return Err(IoError::unsupported(
                uri,
                "a database (SQLite: .3dtiles, MBTiles, GeoPackage) as a source of tiles",
            ));
        }
        let start = bytes.get(..4.min(bytes.len())).unwrap_or(&[]);
        Err(IoError::invalid(
            uri,
            format!("of no known format: it begins with {start:02x?} (\"{}\")", start.escape_ascii()),
        ))
    }
}

/// Returns true for GeoJSON, which tile sets have with MAXAR_content_geojson.
fn is_geojson(json: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Probe {
        r#type: String,
    }
    let probe = serde_json::from_slice::<Probe>(json);
    probe.is_ok_and(|probe| matches!(probe.r#type.as_str(), "FeatureCollection" | "Feature" | "GeometryCollection"))
}

#[cfg(all(test, feature = "http"))]
mod tests {
    use super::*;

    /// The capabilities of a map server have megabytes.
    #[test]
    fn documents_of_map_servers_do_not_hold_up_requests() {
        let known = |bytes: &[u8]| [(Arc::from("http://h/a"), Ok(bytes.to_vec()))];
        assert!(has_slow_dependencies(b"glTF", &known(b"\xef\xbb\xbf <?xml version=\"1.0\"?><Capabilities/>")));
        assert!(!has_slow_dependencies(b"glTF", &known(b"\x89PNG")) && !has_slow_dependencies(b"glTF", &[]));
        assert!(has_slow_dependencies(&[b' '; 100_000], &[]));
    }

    /// The thread that uploads looked through all vertices of formats whose readers do not.
    #[test]
    fn decoders_find_the_vertex_format() {
        const FILE: &str = "#Ascii Scene \n#Version 161 \n#Generator OpenSceneGraph 3.6.5 \n
            osg::Geode { UniqueID 1 Drawables 1 { osg::Geometry { UniqueID 2
            PrimitiveSetList 1 { osg::DrawArrays { UniqueID 3 Mode TRIANGLES Count 3 } }
            VertexArray TRUE { osg::Vec3Array { UniqueID 4 Binding BIND_PER_VERTEX vector 3 { 0 0 0 \n 1 0 0 \n 0 1 0 } } } } } }";
        let options = ReadOptions::for_root("/set/a.osgt", crate::fetch::Limits::default());
        let uri = Arc::from("/set/a.osgt");
        let content = Content { uri, bytes: FILE.into(), reader_data: None, companions: Vec::new() };
        let page = decode(content, &options).unwrap();
        assert!(page.drawables().len() == 1 && page.drawables()[0].has_vertex_format());
    }
}
