//! tileset.json of OGC 3D Tiles 1.0 and 1.1 (explicit tilesets): parsed to [`Tile`]s and converted to nodes.

mod detect;
mod extras;
mod json;
mod reader;
mod tile;
mod volume;

#[cfg(feature = "http")]
pub(super) use detect::may_be_tileset;
pub(super) use detect::{is_tileset, is_tileset_text};
pub(super) use json::{TileJson, parse};
pub(super) use reader::read_tiles;
pub(super) use tile::Tile;

use std::sync::Arc;

use super::options::ReadOptions;
use crate::fetch::IoError;
use crate::scene::Node;

/// Reads a tileset as nodes: a tile is a PagedLod, an external tileset a ProxyNode.
pub(super) fn read(uri: &Arc<str>, bytes: &[u8], options: &ReadOptions) -> Result<Node, IoError> {
    read_tiles(uri, bytes, options).map(Tile::into_node)
}
