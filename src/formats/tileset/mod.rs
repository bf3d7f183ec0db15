//! tileset.json of OGC 3D Tiles 1.0 and 1.1: parsed to tiles and converted to nodes.

mod detect;
mod extras;
mod json;
mod reader;
mod set_metadata;
mod volume;

#[cfg(feature = "http")]
pub(super) use detect::may_refer_to_files;
pub(super) use detect::{is_tileset, is_tileset_text, may_be_tileset};
pub(super) use json::{parse, schema_reference};
pub(super) use reader::read_tiles;
pub(super) use volume::volume_and_frame;

use std::sync::Arc;

use super::ignored::Notes;
use super::options::{Fetched, ReadOptions};
use super::tile::{Body, ELLIPSOID, Tile};
use crate::fetch::{IoError, Limits, encoding};
use crate::scene::Node;

/// Returns the body that a root tileset declares; `None` for other files, and if its radii are invalid.
pub(super) fn body_of(uri: &str, bytes: &[u8], limits: &Limits) -> Option<Body> {
    // Tilesets may be large, and few have the extension.
    let bytes = encoding::gunzip(uri, bytes.to_vec(), limits).ok()?;
    let may_declare = bytes.windows(ELLIPSOID.len()).any(|text| text == ELLIPSOID.as_bytes());
    may_declare.then(|| json::parse(uri, &bytes, limits).ok()?.body()?.ok()).flatten()
}

/// Reads a tileset as nodes: a tile is a PagedLod, an external tileset a ProxyNode.
pub(super) fn read(
    uri: &Arc<str>,
    bytes: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Node, IoError> {
    reader::read_noting(uri, bytes, companions, options, notes).map(Tile::into_node)
}
