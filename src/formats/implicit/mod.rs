//! Implicit tiling of 3D Tiles 1.1, and the extension `3DTILES_implicit_tiling` of 1.0: quadtrees and octrees whose tiles
//! follow from bits in subtree files. Called by the reader of tilesets and by decode threads.
//!
//! | file | contents |
//! |---|---|
//! | `tiling` | what all tiles of a tree share; volumes and errors by halving |
//! | `subtree`, `availability` | a subtree file: which tiles, contents and child subtrees there are |
//! | `metadata`, `semantics` | metadata of tiles and contents; what it replaces |
//! | `pages` | parts of the tree as tiles of pages, made when they are wanted |
//! | `coordinates`, `template`, `json` | indices, URIs and the JSON |

mod availability;
mod coordinates;
mod json;
mod metadata;
mod pages;
mod semantics;
mod subtree;
mod template;
mod tiling;

pub(super) use coordinates::TileCoordinates;
pub(super) use json::ImplicitTilingJson;
pub(super) use pages::{SubtreePart, SubtreeSource};
pub(super) use template::UriTemplate;
pub(super) use tiling::{ContentTemplate, HeightTemplate, ImplicitRoot, ImplicitTiling, RootVolume};

use std::sync::Arc;

use super::options::ReadOptions;

/// Returns the absolute URIs of the external buffers that hold bits of a subtree file, without those that are not allowed.
pub(super) fn external_buffers(
    source: &SubtreeSource,
    uri: &str,
    bytes: &[u8],
    options: &ReadOptions,
) -> Vec<Arc<str>> {
    let resolved = |reference: &String| options.resolve(uri, reference).ok().map(|(uri, _)| uri);
    source.external_buffers(bytes, options).iter().filter_map(resolved).collect()
}
