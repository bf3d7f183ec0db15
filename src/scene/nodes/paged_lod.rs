//! Tiles and proxies as values: the nodes whose contents are paged. Built by readers and applications on any thread.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

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

/// When a tile gives way to (or is joined by) its children.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RangeMode {
    /// Refine when the error projects to more than the camera's limit in pixels, as 3D Tiles has it. Metres in the
    /// node's frame.
    ScreenSpaceError {
        /// Error in metres of drawing this tile instead of its children.
        geometric_error_m: f64,
    },
    /// Refine when the distance from the eye to `center`, times the LOD scale, is below `range_m`
    /// (OSG's DISTANCE_FROM_EYE_POINT).
    Distance {
        /// Centre in the node's frame.
        center: DVec3,
        /// Metres.
        range_m: f64,
    },
    /// Refine when a sphere covers more pixels of the picture, over the LOD scale, than so many, whatever error the camera
    /// allows (OSG's PIXEL_SIZE_ON_SCREEN).
    PixelSize {
        /// Its centre in the node's frame.
        center: DVec3,
        /// Its radius, metres of the same frame.
        radius_m: f64,
        /// Pixels across; 0 or no number refines at any size.
        size_px: f64,
    },
}

/// A tile of a paged tree. Its children in [`Node::children`] are tiles (or proxies) too.
#[derive(Clone, Debug)]
pub struct PagedLod {
    /// Declared volume in the page's tile frame; never dirtied by what is loaded (OSG's USER_DEFINED_CENTER). Where nobody
    /// knows it, [`BoundingSphere::EVERYTHING`]: the content is asked for from anywhere, and culled by bounds of its own
    /// once it is there. OSG's union of both is a sphere's [`union`](BoundingSphere::union) with what
    /// [`Node::bounding_sphere`] says of the children.
    pub bounds: BoundingVolume,
    /// When the children are wanted.
    pub range_mode: RangeMode,
    /// REPLACE or ADD.
    pub refine: Refine,
    /// Absolute URI of the content ([`set_database_path`](crate::io::set_database_path) makes it so); `None` for an empty tile, which shows its children in their range, and nothing beyond:
    /// below content that is replaced give it a range that is always met, or there are holes.
    pub content: Option<Arc<str>>,
    /// Node-from-content map applied to the page that the content becomes (the tile's transform).
    pub content_transform: DAffine3,
    /// Opaque to the scene; handed back to the reader with the content's URI (height tile parameters and the like).
    pub reader_data: Option<Arc<str>>,
    /// Where the eye must be for the tile and what is below it to be drawn or asked for (3D Tiles'
    /// `viewerRequestVolume`), in the frame of `bounds`; `None` is anywhere. From outside of it the content that the tile
    /// and its siblings would replace stays.
    pub request_volume: Option<BoundingVolume>,
    /// How the pager treats the content.
    pub paging: PagingOptions,
}

/// How the pager treats a tile's content: what OSG's PagedLOD has besides ranges and files.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PagingOptions {
    /// The priority, pixels of error, is multiplied by it; OSG's priority scale.
    pub priority_scale: f32,
    /// And this is added; OSG's priority offset. The sum is not below 0.
    pub priority_offset: f32,
    /// Frames that it stays at least after it was last wanted, however little room there is.
    pub min_expiry_frames: u32,
    /// Seconds of the same.
    pub min_expiry_s: f32,
    /// Once loaded it stays; OSG's children that cannot be expired. It counts in the budgets all the same.
    pub cannot_expire: bool,
}

impl Default for PagingOptions {
    /// Nothing is special.
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
    /// What a cull asked for with a priority. What is wanted only later (below 0) stays so, in its order.
    pub fn priority(&self, asked: f32) -> f32 {
        let priority = asked * self.priority_scale + self.priority_offset;
        if asked < 0.0 || !priority.is_finite() { asked } else { priority.max(0.0) }
    }
}

/// A place for a page that is read from `uri`.
#[derive(Clone, Debug)]
pub struct ProxyNode {
    /// Absolute URI of what is loaded.
    pub uri: Arc<str>,
    /// Declared bound in the node's frame (OSG's USER_DEFINED_CENTER). Where nobody knows it,
    /// [`BoundingSphere::EVERYTHING`] (OSG's USE_BOUNDING_SPHERE_CENTER): seen from anywhere until it is loaded, from then
    /// on culled by the bounds of what is there.
    pub bounds: BoundingSphere,
    /// Node-from-content map.
    pub content_transform: DAffine3,
    /// When it is loaded.
    pub loading: ProxyLoading,
}

/// When a [`ProxyNode`] loads its children.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProxyLoading {
    /// When cull first sees it, by the pager.
    #[default]
    DeferToPager,
    /// By the pager as soon as the page that it is in is in the scene, before all that cameras want and wherever they
    /// look; it does not expire.
    Immediately,
    /// Only when the application asks: [`Scene::load_proxy`](super::Scene::load_proxy).
    Never,
}
