//! What can go wrong when a scene is built or changed.

use super::{AttributeFormat, NodeId, PageId};

/// Why a scene operation was refused. Nothing was changed when one is returned.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SceneError {
    /// Only tiles and proxies may hang below a tile or proxy.
    #[error("a {kind} hangs below a tile; only PagedLod and ProxyNode may")]
    TileChild {
        /// The kind's name.
        kind: &'static str,
    },
    /// The graph is deeper than [`super::MAX_DEPTH`].
    #[error("the graph is deeper than {limit} nodes")]
    TooDeep {
        /// The limit.
        limit: usize,
    },
    /// More nodes, drawables or transforms than 32-bit indices name.
    #[error("the graph has too many nodes, drawables or transforms")]
    TooLarge,
    /// The page is not (any more) in the scene.
    #[error("page {}.{} is not in the scene", page.slot, page.generation)]
    StalePage {
        /// The handle given.
        page: PageId,
    },
    /// The node is not in the scene.
    #[error("node {} of page {}.{} is not in the scene", node.index, node.page.slot, node.page.generation)]
    StaleNode {
        /// The handle given.
        node: NodeId,
    },
    /// The node has no place for a page.
    #[error("node {} has no content slot", node.index)]
    NotASlot {
        /// The handle given.
        node: NodeId,
    },
    /// Another page is there already.
    #[error("the slot of node {} is taken", node.index)]
    SlotTaken {
        /// The handle given.
        node: NodeId,
    },
    /// Other pages still hang in the page's slots.
    #[error("{count} pages hang in page {}.{}", page.slot, page.generation)]
    HasPages {
        /// The handle given.
        page: PageId,
        /// How many.
        count: u32,
    },
    /// A root page is removed with `remove_root`.
    #[error("page {}.{} is a root page", page.slot, page.generation)]
    IsRoot {
        /// The handle given.
        page: PageId,
    },
    /// The node is not a transform.
    #[error("node {} is not a Transform", node.index)]
    NotATransform {
        /// The handle given.
        node: NodeId,
    },
    /// The node is not a camera.
    #[error("node {} is not a Camera", node.index)]
    NotACamera {
        /// The handle given.
        node: NodeId,
    },
    /// The node is not a Switch, or has no such child.
    #[error("node {} is not a Switch with a child {child}", node.index)]
    NotASwitch {
        /// The handle given.
        node: NodeId,
        /// The child given.
        child: usize,
    },
    /// The node is not a Geode, or has no such drawable.
    #[error("node {} is not a Geode with a drawable {drawable}", node.index)]
    NotAMesh {
        /// The handle given.
        node: NodeId,
        /// The drawable given.
        drawable: usize,
    },
    /// A transform with NaN or infinite entries.
    #[error("the transform is not finite")]
    NotFinite,
}

/// Why a mesh was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// Not one element of an attribute for each vertex.
    #[error("attribute {name:?} of {format:?} has {bytes} bytes for {vertices} vertices of {} each", .format.size_bytes())]
    AttributeLength {
        /// Of the attribute.
        name: String,
        /// Given for its elements.
        format: AttributeFormat,
        /// Of the mesh.
        vertices: usize,
        /// Given.
        bytes: usize,
    },
    /// A name that the mesh or all meshes have.
    #[error("a mesh has an attribute {name:?} already")]
    AttributeTwice {
        /// Of the attribute.
        name: String,
    },
    /// More than [`MAX_ATTRIBUTES`](super::MAX_ATTRIBUTES).
    #[error("attribute {name:?} is one more than the {limit} that a mesh can have")]
    TooManyAttributes {
        /// Of the attribute.
        name: String,
        /// The limit.
        limit: usize,
    },
    /// An index of no vertex.
    #[error("index {index} of {vertices} vertices")]
    IndexOutside {
        /// The first such index.
        index: u32,
        /// Of the mesh.
        vertices: usize,
    },
}
