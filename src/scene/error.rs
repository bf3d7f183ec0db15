//! Errors of building and changing scenes and meshes.

use super::{AttributeFormat, NodeId, PageId};

/// Why a scene operation was refused. The scene is unchanged when an error is returned.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SceneError {
    /// A node other than a tile or proxy is below a tile or proxy.
    #[error("a {kind} is below a tile, where only PagedLod and ProxyNode are allowed")]
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
    /// The graph has more nodes, drawables or transforms than 32-bit indices allow.
    #[error("the graph has too many nodes, drawables or transforms")]
    TooLarge,
    /// The page is not in the scene, or no longer.
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
    /// The node has no slot for a page.
    #[error("node {} has no content slot", node.index)]
    NotASlot {
        /// The handle given.
        node: NodeId,
    },
    /// Another page is in the slot.
    #[error("the slot of node {} is taken", node.index)]
    SlotTaken {
        /// The handle given.
        node: NodeId,
    },
    /// Other pages are attached to the page's slots.
    #[error("{count} pages are attached to page {}.{}", page.slot, page.generation)]
    HasPages {
        /// The handle given.
        page: PageId,
        /// The number of attached pages.
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
    /// A transform has NaN or infinite entries.
    #[error("the transform is not finite")]
    NotFinite,
}

/// Why a mesh was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// An attribute does not have one element for each vertex.
    #[error("attribute {name:?} of {format:?} has {bytes} bytes for {vertices} vertices of {} each", .format.size_bytes())]
    AttributeLength {
        /// The name of the attribute.
        name: String,
        /// The format given.
        format: AttributeFormat,
        /// The number of vertices of the mesh.
        vertices: usize,
        /// The number of bytes given.
        bytes: usize,
    },
    /// The mesh, or every mesh, has an attribute of that name.
    #[error("a mesh has an attribute {name:?} already")]
    AttributeTwice {
        /// The name of the attribute.
        name: String,
    },
    /// The mesh would have more than [`MAX_ATTRIBUTES`](super::MAX_ATTRIBUTES).
    #[error("attribute {name:?} is one more than the {limit} that a mesh can have")]
    TooManyAttributes {
        /// The name of the attribute.
        name: String,
        /// The limit.
        limit: usize,
    },
    /// An index is out of range.
    #[error("index {index} is out of range: the mesh has {vertices} vertices")]
    IndexOutside {
        /// The first such index.
        index: u32,
        /// The number of vertices of the mesh.
        vertices: usize,
    },
}
