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
//!   special            cameras, billboards, lights, clip planes, queries; occluders were collected before
//!   fade               what is drawn beside what takes its place, for a short time
//!   state_graph        find-or-insert of state sets under their parent
//!   sort               leaves to bins, in draw order
//! then the shadows' cascades, each culled alike into a stage of its own
//! and the cameras in the graph that are drawn before or after: a stage of their own each, culled alike, with shadows
//! where they ask
//! ```

mod camera;
mod cameras;
mod drawables;
mod fade;
mod horizon;
mod near_far;
mod nodes;
mod occluders;
mod planes;
mod shadows;
mod sort;
mod special;
mod stage;
mod state_graph;
mod states;
mod stereo;
mod tiles;
mod view;
mod visitor;

pub use camera::CullCamera;
pub use fade::FadeBand;
pub use shadows::{MAX_CASCADES, ShadowCascade, ShadowError, StageShadows, SunShadows};
pub use stage::{
    ClipPlane, CullCounters, OcclusionQuery, PageRequest, PositionedLight, PositionedTexGen, RenderBin, RenderLeaf,
    RenderStage, StageTarget, StageView,
};
pub(crate) use stage::{moved, plane_moved};
pub use stereo::{Stereo, StereoMode};
pub use visitor::CullVisitor;

pub use crate::scene::{CullSettings, CullingMode, SMALL_FEATURE_PX};
