//! Cull: from `&Scene` and a camera to a [`RenderStage`].
//!
//! Runs once per camera and frame, on any thread: it takes no lock, calls no GPU and no pager. What it wants to be
//! loaded leaves as data ([`PageRequest`]); tiles that it wanted are stamped with the frame number through relaxed
//! atomics. Once warm it allocates nothing.
//!
//! ```text
//! CullVisitor::cull    page queue: the root pages, then the pages that tiles hang in, breadth first
//!   nodes              flat depth-first scan of a page; subtrees wholly inside become two ranges
//!   tiles              tile trees: REPLACE and ADD, screen-space error, requests; horizon: what the earth hides
//!   state_graph        find-or-insert of state sets under their parent
//!   sort               leaves to bins, in draw order
//! ```

mod camera;
mod horizon;
mod nodes;
mod planes;
mod sort;
mod stage;
mod state_graph;
mod tiles;
mod visitor;

pub use camera::{CullCamera, CullingMode, SMALL_FEATURE_PX};
pub use stage::{CullCounters, PageRequest, RenderBin, RenderLeaf, RenderStage};
pub use visitor::CullVisitor;
