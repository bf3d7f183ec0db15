//! The scene: pages of nodes, and what nodes draw.
//!
//! [`Node`] trees are built anywhere and flattened once into a [`Page`]. A [`Scene`] owns pages: update changes it
//! through `&mut Scene`, cull reads it through `&Scene` from any number of threads.

mod error;
mod flatten;
mod geometry;
mod graph;
mod id;
mod node;
mod page;
mod slots;
mod tiles;
mod transforms;

pub use error::SceneError;
pub use flatten::MAX_DEPTH;
pub use geometry::{AlphaMode, Drawable, Geometry, HeightTile, Material, Mesh, MeshVertex, Texture, Topology};
pub use graph::Scene;
pub use id::{NodeId, PageId};
pub use node::{Node, NodeKind, PagedLod, ProxyLoading, ProxyNode, RangeMode, Refine};
pub use page::{DrawSlot, Page};
pub use slots::{SlotInfo, SlotState};

pub(crate) use page::{BLEND, NONE, PLAIN, UNBOUNDED, kind};
pub(crate) use tiles::{TileBounds, TileRecord, flag};
