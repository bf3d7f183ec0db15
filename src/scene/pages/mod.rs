//! Pages: the flat form of a node graph, which culls scan.
//!
//! [`PageBuilder`] collects nodes in depth-first order on a decode worker and finishes a [`Page`]. While the page is in a
//! scene, update changes it through `&mut Page` and culls read it through `&Page`.
//!
//! ```text
//! Page
//!   NodeArrays       records, parents, masks and payload indices of nodes   what the node scan reads
//!   NodeSpheres      bounding spheres of nodes, origin, stale nodes         what the node scan reads
//!   DrawableArrays   frames, states and boxes of drawables                  what the drawable scan reads
//!   Transforms       page-from-node maps                                    shared by index
//!   StatePaths       chains of state sets                                   shared by index
//!   PayloadTables    switches, LOD ranges, rare nodes, occluders            by the nodes' payload index
//!   NodeExtras       names and callbacks                                    sorted by node
//!   Tiles            tile trees (see `tile_tree`)                           what the tile walk reads
//!   PagePayload      drawables before upload, k-d trees, shared contents, draw slots
//! ```

mod drawable_arrays;
mod node_arrays;
mod node_extras;
mod node_spheres;
mod page;
mod page_bounds;
mod page_builder;
mod page_payload;
mod payload_tables;
mod single_drawable;
mod state_paths;
mod stored_bounds;
mod transforms;

pub(crate) use node_arrays::{CALLBACK, INACTIVE, LARGE, SIMPLE_SUBTREE, UNCULLED, kind};
pub(crate) use page_builder::PageBuilder;
pub(crate) use payload_tables::{OccluderRecord, RareNode};
pub(crate) use single_drawable::SingleDrawable;
pub(crate) use state_paths::{BLEND, LIGHTS, VIEW};
pub(crate) use stored_bounds::UNBOUNDED;

pub use page::Page;
pub use page_payload::DrawSlot;
