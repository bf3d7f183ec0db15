//! [`Tile`]: a tile of a tileset with absolute URIs and bounds in the tileset's frame, and its conversion to nodes.

use std::sync::Arc;

use glam::DAffine3;

use super::content::{TileContent, joined, with_bounds};
use crate::fetch::IoError;
use crate::math::BoundingVolume;
use crate::scene::{Node, NodeKind, PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine, TileMetadata};

/// A geometric error in metres that exceeds the threshold from every eye position, so that the tile is always refined.
pub(in crate::formats) const ALWAYS_REFINED_M: f64 = f64::MAX / 1e6;

/// Parts of a tile tree are requested before contents of this many times their priority: what is below them is unknown
/// until they are read.
const TREE_PRIORITY_SCALE: f32 = 4.0;

/// A part of the tree below a tile that becomes a page when it is wanted.
pub(in crate::formats) struct Continuation {
    pub bounds: BoundingVolume,
    pub content: TileContent,
}

/// A tile of a tileset.
pub(in crate::formats) struct Tile {
    pub bounds: BoundingVolume,
    /// The tile is drawn only while the eye is inside this volume.
    pub request_volume: Option<BoundingVolume>,
    pub refine: Refine,
    pub geometric_error_m: f64,
    /// Maps contents to the tileset's frame.
    pub content_transform: DAffine3,
    /// The contents, known tilesets excluded.
    pub contents: Vec<TileContent>,
    /// The external tilesets.
    pub external_tilesets: Vec<TileContent>,
    /// Parts of the tree with further children.
    pub continuations: Vec<Continuation>,
    /// The metadata of the tile, of its tileset and subtree, if it is kept.
    pub metadata: Option<Arc<TileMetadata>>,
    pub children: Vec<Self>,
}

impl Tile {
    /// Returns a tile whose only content fails with an error.
    pub fn refused(bounds: BoundingVolume, refine: Refine, uri: Arc<str>, error: IoError) -> Self {
        Self {
            bounds,
            request_volume: None,
            refine,
            geometric_error_m: 0.0,
            content_transform: DAffine3::IDENTITY,
            contents: vec![TileContent::refused(uri, error)],
            external_tilesets: Vec::new(),
            continuations: Vec::new(),
            metadata: None,
            children: Vec::new(),
        }
    }

    /// Converts the tile and its descendants to nodes.
    ///
    /// A tile with several contents that nothing replaces becomes a `MultiContentTile`: an empty, always refined ADD tile
    /// above one tile per content. So its contents are loaded and drawn together, and fail alone. Contents that children
    /// replace become one content, since they must leave in the same frame.
    ///
    /// A content below which nothing is has its own volume in place of the tile's. Another content keeps its volume beside the
    /// tile's, unless they are about as large.
    pub fn into_node(mut self) -> Node {
        let is_leaf = self.children.is_empty() && self.external_tilesets.is_empty() && self.continuations.is_empty();
        if self.contents.len() > 1 && !is_leaf && self.refine == Refine::Replace {
            self.contents = vec![joined(std::mem::take(&mut self.contents))];
        }
        let Self { bounds, request_volume, refine, content_transform, geometric_error_m, .. } = self;
        let external = |tileset: TileContent| {
            let proxy = ProxyNode {
                uri: tileset.uri,
                bounds: bounds.bounding_sphere(),
                content_transform,
                loading: ProxyLoading::DeferToPager,
            };
            Node { metadata: tileset.metadata, ..Node::new(NodeKind::ProxyNode(Box::new(proxy))) }
        };
        let children: Vec<Node> = (self.external_tilesets.into_iter().map(external))
            .chain(self.continuations.into_iter().map(Continuation::into_node))
            .chain(self.children.into_iter().map(Self::into_node))
            .collect();
        let paged_lod = |bounds, geometric_error_m, refine, content: Option<TileContent>| {
            let in_tree = content.as_ref().is_some_and(TileContent::continues_tileset);
            let (content, reader_data) = content.map_or((None, None), |c| (Some(c.uri), c.reader_data));
            Box::new(PagedLod {
                bounds,
                range_mode: RangeMode::ScreenSpaceError { geometric_error_m },
                refine,
                content,
                // Parts of the tree are in the tileset's frame already.
                content_transform: if in_tree { DAffine3::IDENTITY } else { content_transform },
                reader_data,
                request_volume,
                paging: paging(in_tree),
            })
        };
        let node_with = |geometric_error_m, content: Option<TileContent>, children: Vec<Node>| {
            let metadata = content.as_ref().and_then(|content| content.metadata.clone());
            let mut content = content;
            let mut own = content.as_ref().and_then(|content| content.bounds);
            if !children.is_empty()
                && let Some(volume) = own.take()
                && is_smaller(&volume, &bounds)
                && let Some(content) = &mut content
            {
                content.reader_data = with_bounds(content.reader_data.take(), volume);
            }
            let tile = paged_lod(own.unwrap_or(bounds), geometric_error_m, refine, content);
            Node { metadata, children, ..Node::new(NodeKind::PagedLod(tile)) }
        };
        let mut contents = self.contents.into_iter();
        let tile = node_with(geometric_error_m, contents.next(), children);
        if contents.len() == 0 {
            return Node { metadata: TileMetadata::with_content(self.metadata, tile.metadata), ..tile };
        }
        let others = contents.map(|content| node_with(0.0, Some(content), Vec::new()));
        let children = std::iter::once(tile).chain(others).collect();
        let group = paged_lod(bounds, ALWAYS_REFINED_M, Refine::Add, None);
        Node { metadata: self.metadata, children, ..Node::new(NodeKind::MultiContentTile(group)) }
    }
}

impl Continuation {
    fn into_node(self) -> Node {
        let Self { bounds, content } = self;
        Node::new(NodeKind::PagedLod(Box::new(PagedLod {
            bounds,
            range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
            refine: Refine::Replace,
            content: Some(content.uri),
            content_transform: DAffine3::IDENTITY,
            reader_data: content.reader_data,
            request_volume: None,
            paging: paging(true),
        })))
    }
}

fn paging(in_tree: bool) -> PagingOptions {
    let priority_scale = if in_tree { TREE_PRIORITY_SCALE } else { 1.0 };
    PagingOptions { priority_scale, ..PagingOptions::default() }
}

/// Returns tiles as one node.
pub(in crate::formats) fn node_of(tiles: Vec<Tile>) -> Node {
    Node::group(tiles.into_iter().map(Tile::into_node).collect())
}

/// The share of a tile's radius up to which the volume of its content is worth a test of its own.
const MAX_RADIUS_SHARE: f64 = 0.9;

/// Returns true if a volume may be out of sight while the larger one around it is mostly in sight.
fn is_smaller(volume: &BoundingVolume, around: &BoundingVolume) -> bool {
    volume.bounding_sphere().radius_m < MAX_RADIUS_SHARE * around.bounding_sphere().radius_m
}
