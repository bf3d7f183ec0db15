//! Decodes the bytes of one content to a page. Formats are recognized by magic bytes, never by file extension.

use std::sync::Arc;

use super::options::{Content, ReadOptions};
use super::{b3dm, gltf, height, image, point_cloud, tileset};
use crate::fetch::markup::{refuse_markup, text_and_first_byte};
use crate::fetch::{IoError, encoding, guarded};
use crate::scene::{Node, Page};

/// Returns the other URIs that a content needs: the imagery of a height tile.
pub fn companions(uri: &Arc<str>, reader_data: Option<&Arc<str>>) -> Vec<Arc<str>> {
    height::companions(uri, reader_data)
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
    let limits = &options.limits;
    let sharing = options.sharing.as_deref();
    let bytes = encoding::gunzip(&uri, bytes, limits)?;
    let (text, first) = text_and_first_byte(&bytes);
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
        return point_cloud::read(&uri, &bytes, limits);
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
        return if tileset::is_tileset_text(&uri, text)? {
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
