//! Decodes the bytes of one content to a page. Formats are recognized by magic bytes, never by file extension.

use std::sync::Arc;

use super::implicit::{SubtreePart, SubtreeSource};
use super::options::{Content, Fetched, ReadOptions};
use super::tile::{ContentBytes, ContentData, TileContent, node_of};
use super::{b3dm, cmpt, embedded, gltf, height, image, implicit, point_cloud, tileset};
use crate::fetch::markup::{refuse_markup, text_and_first_byte};
use crate::fetch::{IoError, encoding, guarded};
use crate::scene::{Node, Page, ReaderData};

/// Returns the other URIs that a content needs and that are known before it is read: the imagery of a height tile, or the
/// other contents of a tile.
pub fn companions(uri: &Arc<str>, reader_data: Option<&ReaderData>) -> Vec<Arc<str>> {
    if let Some(ContentBytes::Several(contents)) = content_data(reader_data).map(|data| &data.bytes) {
        let mut fetched = contents.iter().filter(|content| !content.is_in_memory());
        // The first is the content itself.
        fetched.next();
        return fetched.map(|content| content.uri.clone()).collect();
    }
    height::companions(uri, reader_data.and_then(ReaderData::text))
}

/// Returns the files that a content refers to and that are not in `known`: external buffers of a subtree. A loader fetches
/// them after the content, adds them to its companions, and asks again until none is left. References that are not allowed
/// are left out; the decoder reports them. Any thread.
pub fn dependencies(
    uri: &str,
    bytes: &[u8],
    reader_data: Option<&ReaderData>,
    known: &[Fetched],
    options: &ReadOptions,
) -> Vec<Arc<str>> {
    let source = reader_data.and_then(|data| data.value::<SubtreeSource>());
    let needed = source.map_or(Vec::new(), |source| implicit::external_buffers(source, uri, bytes, options));
    let mut unknown: Vec<Arc<str>> = Vec::new();
    for dependency in needed {
        if !known.iter().any(|(fetched, _)| *fetched == dependency) && !unknown.contains(&dependency) {
            unknown.push(dependency);
        }
    }
    unknown
}

/// Decodes a content to a page. CPU only, no I/O; any thread.
///
/// If a crate behind a decoder panics, only this content fails, with the reason
/// [`DECODER_PANICKED`](crate::fetch::DECODER_PANICKED).
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

/// Decodes a content to nodes: [`decode`] without building a page.
pub fn decode_node(content: Content, options: &ReadOptions) -> Result<Node, IoError> {
    let Content { uri, bytes, reader_data, companions } = content;
    if let Some(part) = reader_data.as_ref().and_then(|data| data.value::<SubtreePart>()) {
        return Ok(node_of(part.read()));
    }
    if let Some(source) = reader_data.as_ref().and_then(|data| data.value::<SubtreeSource>()) {
        let bytes = encoding::gunzip(&uri, bytes, &options.limits)?;
        return source.read(&uri, bytes, &companions, options).map(node_of);
    }
    let Some(data) = content_data(reader_data.as_ref()) else {
        let text = reader_data.as_ref().and_then(ReaderData::text);
        return decode_bytes(&uri, bytes, text, companions, options);
    };
    let options = &ReadOptions { gltf_up_axis: data.up_axis, ..options.clone() };
    match &data.bytes {
        ContentBytes::Fetched => decode_bytes(&uri, bytes, None, companions, options),
        ContentBytes::Embedded(reference) => {
            let bytes = embedded::data_uri(&uri, reference)?;
            decode_bytes(&uri, bytes, None, companions, options)
        }
        ContentBytes::Refused(error) => Err(error.clone()),
        ContentBytes::Several(contents) => decode_several(contents, (uri, Ok(bytes)), companions, options),
    }
}

fn content_data(reader_data: Option<&ReaderData>) -> Option<&ContentData> {
    reader_data?.value()
}

/// Decodes all contents of a tile to one node.
fn decode_several(
    contents: &[TileContent],
    first: Fetched,
    companions: Vec<Fetched>,
    options: &ReadOptions,
) -> Result<Node, IoError> {
    let mut fetched = std::iter::once(first).chain(companions);
    let mut nodes = Vec::with_capacity(contents.len());
    for content in contents {
        let bytes = if content.is_in_memory() {
            Vec::new()
        } else {
            let missing = || IoError::NotFound { uri: content.uri.to_string() };
            fetched.next().ok_or_else(missing)?.1?
        };
        let (uri, reader_data) = (content.uri.clone(), content.reader_data.clone());
        nodes.push(decode_node(Content { uri, bytes, reader_data, companions: Vec::new() }, options)?);
    }
    Ok(Node::group(nodes))
}

/// Decodes the bytes of a content by their magic. `text` is the reader data of a height tile.
fn decode_bytes(
    uri: &Arc<str>,
    bytes: Vec<u8>,
    text: Option<&str>,
    companions: Vec<Fetched>,
    options: &ReadOptions,
) -> Result<Node, IoError> {
    let limits = &options.limits;
    let bytes = encoding::gunzip(uri, bytes, limits)?;
    if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return height::read(uri, &bytes, text, companions, limits, options.sharing.as_deref());
    }
    decode_model(uri, &bytes, options, 0)
}

/// Decodes a model, or a composite of models inside `depth` others, by its magic.
fn decode_model(uri: &Arc<str>, bytes: &[u8], options: &ReadOptions, depth: u32) -> Result<Node, IoError> {
    let (json, first) = text_and_first_byte(bytes);
    if bytes.starts_with(b"glTF") {
        return gltf::read_glb(uri, bytes, None, options);
    }
    if bytes.starts_with(b"b3dm") {
        let (glb, center) = b3dm::unwrap(uri, bytes)?;
        return gltf::read_glb(uri, glb, center, options);
    }
    if bytes.starts_with(b"pnts") {
        return point_cloud::read(uri, bytes, options);
    }
    if bytes.starts_with(b"cmpt") {
        let parts = cmpt::parts(uri, bytes, depth)?;
        let nodes = parts.into_iter().map(|part| decode_model(uri, part, options, depth + 1));
        return nodes.collect::<Result<Vec<_>, _>>().map(Node::group);
    }
    for (magic, what) in [
        (&b"i3dm"[..], "instanced model (i3dm)"),
        (b"subt", "a subtree outside of implicit tiling"),
        (b"PMTiles", "a whole PMTiles file as the content of a tile"),
    ] {
        if bytes.starts_with(magic) {
            return Err(IoError::unsupported(uri, what));
        }
    }
    if first == Some(b'{') {
        return if tileset::is_tileset_text(uri, json)? {
            tileset::read(uri, json, options)
        } else {
            gltf::read_gltf(uri, json, options)
        };
    }
    refuse_markup(uri, bytes)?;
    if image::is_image(bytes) {
        return Err(IoError::unsupported(uri, "an image as the content of a tile"));
    }
    Err(IoError::invalid(uri, format!("unknown magic {:02x?}", bytes.get(..4.min(bytes.len())).unwrap_or(&[]))))
}
