//! [`Tile`]: a tile of a tileset with absolute URIs and bounds in the tileset's frame, and its conversion to nodes.

use std::sync::Arc;

use glam::DAffine3;

use crate::math::BoundingVolume;
use crate::scene::{Node, NodeKind, PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine};

/// A geometric error in metres that exceeds the threshold from every eye position, so that the tile is always refined.
pub(super) const ALWAYS_REFINED_M: f64 = f64::MAX / 1e6;

/// A tile of a tileset.
pub(in crate::formats) struct Tile {
    pub bounds: BoundingVolume,
    /// The tile is drawn only while the eye is inside this volume.
    pub request_volume: Option<BoundingVolume>,
    pub refine: Refine,
    pub geometric_error_m: f64,
    /// Maps contents to the tileset's frame.
    pub content_transform: DAffine3,
    /// Data for the decoder of the first content.
    pub reader_data: Option<Arc<str>>,
    /// URIs of the contents, tilesets excluded.
    pub contents: Vec<Arc<str>>,
    /// URIs of the external tilesets.
    pub external_tilesets: Vec<Arc<str>>,
    pub children: Vec<Self>,
}

impl Tile {
    /// Converts the tile and its descendants to nodes.
    ///
    /// A tile with several contents becomes a `MultiContentTile`: an empty, always refined ADD tile above one tile per
    /// content. So its contents are loaded and drawn together.
    pub fn into_node(self) -> Node {
        let Self { bounds, request_volume, refine, content_transform, .. } = self;
        let external = |uri| {
            Node::new(NodeKind::ProxyNode(Box::new(ProxyNode {
                uri,
                bounds: bounds.bounding_sphere(),
                content_transform,
                loading: ProxyLoading::DeferToPager,
            })))
        };
        let paged_lod = |geometric_error_m, refine, content, reader_data| {
            Box::new(PagedLod {
                bounds,
                range_mode: RangeMode::ScreenSpaceError { geometric_error_m },
                refine,
                content,
                content_transform,
                reader_data,
                request_volume,
                paging: PagingOptions::default(),
            })
        };
        let children: Vec<Node> = self
            .external_tilesets
            .into_iter()
            .map(external)
            .chain(self.children.into_iter().map(Self::into_node))
            .collect();
        let mut contents = self.contents.into_iter();
        let first = paged_lod(self.geometric_error_m, refine, contents.next(), self.reader_data);
        let tile = Node { children, ..Node::new(NodeKind::PagedLod(first)) };
        if contents.len() == 0 {
            return tile;
        }
        let others = contents.map(|uri| Node::new(NodeKind::PagedLod(paged_lod(0.0, refine, Some(uri), None))));
        let group = paged_lod(ALWAYS_REFINED_M, Refine::Add, None, None);
        Node { children: std::iter::once(tile).chain(others).collect(), ..Node::new(NodeKind::MultiContentTile(group)) }
    }
}
