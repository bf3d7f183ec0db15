//! Tiles and proxies as values: the nodes whose contents are paged. Built by readers and applications on any thread.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::reader_data::ReaderData;
use crate::math::{BoundingSphere, BoundingVolume};

/// How a tile's children relate to it; 3D Tiles' `refine`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refine {
    /// Children are drawn instead of the tile.
    #[default]
    Replace,
    /// Children are drawn besides the tile.
    Add,
}

/// When a tile is refined: replaced by its children, or joined by them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RangeMode {
    /// The tile is refined if its error projects to more pixels than the camera allows, as in 3D Tiles.
    ScreenSpaceError {
        /// The error of drawing this tile instead of its children, metres of the node's frame.
        geometric_error_m: f64,
    },
    /// The tile is refined if the distance from the eye to `center`, times the LOD scale, is below `range_m` (OSG's
    /// DISTANCE_FROM_EYE_POINT).
    Distance {
        /// The centre in the node's frame.
        center: DVec3,
        /// The range, metres of the node's frame.
        range_m: f64,
    },
    /// The tile is refined if the diameter of a sphere in pixels, divided by the LOD scale, exceeds `size_px`, whatever error
    /// the camera allows (OSG's PIXEL_SIZE_ON_SCREEN).
    PixelSize {
        /// The centre of the sphere in the node's frame.
        center: DVec3,
        /// The radius of the sphere, metres of the same frame.
        radius_m: f64,
        /// The diameter in pixels; 0 or NaN refines at any size.
        size_px: f64,
    },
}

/// A tile of a paged tree. Its children in [`Node::children`](crate::scene::Node::children) are tiles or proxies too.
///
/// Readers of tile sets create tiles; an application can too, and the pager loads their contents when a cull wants them:
///
/// ```
/// use terrane::glam::{DAffine3, DVec3};
/// use terrane::math::{BoundingSphere, BoundingVolume};
/// use terrane::scene::{Node, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine};
/// let tile = PagedLod {
///     bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 100.0)),
///     range_mode: RangeMode::Distance { center: DVec3::ZERO, range_m: 500.0 },
///     refine: Refine::Replace,
///     content: Some("/maps/house.glb".into()),
///     content_transform: DAffine3::IDENTITY,
///     reader_data: None,
///     request_volume: None,
///     paging: PagingOptions::default(),
/// };
/// let page = Page::from_node(Node::new(NodeKind::PagedLod(Box::new(tile)))).unwrap();
/// ```
#[derive(Clone, Debug)]
pub struct PagedLod {
    /// The declared volume in the page's tile frame; loaded content does not change it (OSG's USER_DEFINED_CENTER). If it is
    /// unknown, use [`BoundingSphere::EVERYTHING`]: the content is requested from anywhere, and culled by its own bounds once
    /// it is loaded. For OSG's union of both, unite a sphere ([`union`](BoundingSphere::union)) with the
    /// [`Node::bounding_sphere`](crate::scene::Node::bounding_sphere) of the children.
    pub bounds: BoundingVolume,
    /// When the tile is refined.
    pub range_mode: RangeMode,
    /// Whether children replace the content or are added to it.
    pub refine: Refine,
    /// The absolute URI of the content ([`set_database_path`](crate::formats::set_database_path) makes URIs absolute).
    ///
    /// `None` for an empty tile, which shows its children while it is refined, and nothing otherwise. Below content that is
    /// replaced, an empty tile needs a range that is always met, or there are holes.
    pub content: Option<Arc<str>>,
    /// The node-from-content map of the content (the tile's transform).
    pub content_transform: DAffine3,
    /// Data that is handed back to the reader with the content's URI, such as height tile parameters. The scene ignores it.
    pub reader_data: Option<ReaderData>,
    /// The volume inside which the eye must be for the tile and its descendants to be drawn or requested (3D Tiles'
    /// `viewerRequestVolume`), in the frame of `bounds`; `None` means anywhere. While the eye is outside, the content that
    /// the tile and its siblings would replace stays.
    pub request_volume: Option<BoundingVolume>,
    /// How the pager treats the content.
    pub paging: PagingOptions,
}

/// How the pager treats a tile's content: the settings of OSG's PagedLOD besides ranges and files.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PagingOptions {
    /// A factor on the priority, which is the error in pixels; OSG's priority scale.
    pub priority_scale: f32,
    /// A term that is then added to the priority; OSG's priority offset. The sum is at least 0.
    pub priority_offset: f32,
    /// The minimum number of frames that the content stays after it was last wanted, even if memory is short.
    pub min_expiry_frames: u32,
    /// The minimum number of seconds that the content stays after it was last wanted.
    pub min_expiry_s: f32,
    /// If true, the content is never expired once loaded, like OSG's children that cannot expire. It still counts against the
    /// budgets.
    pub cannot_expire: bool,
}

impl Default for PagingOptions {
    /// Returns options that change nothing.
    fn default() -> Self {
        Self {
            priority_scale: 1.0,
            priority_offset: 0.0,
            min_expiry_frames: 0,
            min_expiry_s: 0.0,
            cannot_expire: false,
        }
    }
}

impl PagingOptions {
    /// Returns the priority of a request that a cull made with priority `asked`. Negative priorities, those of prefetches, are
    /// not changed.
    pub fn priority(&self, asked: f32) -> f32 {
        let priority = asked * self.priority_scale + self.priority_offset;
        if asked < 0.0 || !priority.is_finite() { asked } else { priority.max(0.0) }
    }
}

/// A node whose content is a page that is read from `uri`.
#[derive(Clone, Debug)]
pub struct ProxyNode {
    /// The absolute URI of the content.
    pub uri: Arc<str>,
    /// The declared bound in the node's frame (OSG's USER_DEFINED_CENTER). If it is unknown, use
    /// [`BoundingSphere::EVERYTHING`] (OSG's USE_BOUNDING_SPHERE_CENTER): the content is requested from anywhere, and culled
    /// by its own bounds once it is loaded.
    pub bounds: BoundingSphere,
    /// The node-from-content map.
    pub content_transform: DAffine3,
    /// When the content is loaded.
    pub loading: ProxyLoading,
}

/// When a [`ProxyNode`] loads its children.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProxyLoading {
    /// The pager loads the content when a cull first sees the node.
    #[default]
    DeferToPager,
    /// The pager loads the content as soon as the node's page is in the scene, ahead of everything that cameras want and
    /// wherever they look. It does not expire.
    Immediately,
    /// The content is loaded only if the application calls [`Scene::load_proxy`](crate::scene::Scene::load_proxy).
    Never,
}
