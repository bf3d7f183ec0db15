//! The scene: pages of nodes, and what nodes draw.

mod geometry;
mod id;
mod node;

pub use geometry::{AlphaMode, Drawable, Geometry, HeightTile, Material, Mesh, MeshVertex, Texture, Topology};
pub use id::{DrawSlot, NodeId, PageId};
pub use node::{Node, NodeKind, PagedLod, ProxyLoading, ProxyNode, RangeMode, Refine};
