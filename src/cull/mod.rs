//! Cull: from `&Scene` and a camera to a [`RenderStage`].
//!
//! Runs once per camera and frame, on any thread. It takes no lock and calls neither the GPU nor the pager: what it wants
//! to be loaded is data in its output ([`PageRequest`]). Wanted tiles are stamped with the frame number through relaxed
//! atomics. After the first frames it allocates nothing.
//!
//! ```text
//! CullVisitor::cull
//!   visitor     takes pages from a queue, breadth first, and scans the nodes of each in depth-first order
//!   views       the frustum and the measures that nodes and tiles are tested against
//!   tiles       walks tile trees: refinement by screen-space error, requests, horizon culling
//!   occluders   shadow volumes, collected before the traversal
//!   fading      dither bands of levels of detail that replace one another
//!   sorting     state sets under their parents, and leaves to bins in draw order
//!   shadows     one more cull per cascade of the sun's shadows
//!   stage       the output
//! ```
//! Cameras in the graph that are drawn before or after have their own stages, culled in the same way.

mod camera;
mod fading;
mod occluders;
mod shadows;
mod sorting;
mod stage;
mod stereo;
mod tiles;
mod views;
mod visitor;

pub use camera::CullCamera;
pub use fading::FadeBand;
pub use stage::{
    ClipPlane, CullCounters, CutVolume, DrawnPart, OcclusionQuery, PageRequest, PositionedLight, PositionedTexGen,
    RenderBin, RenderLeaf, RenderStage, ShadowCascade, StageShadows, StageTarget, StageView,
};
pub(crate) use stage::{move_light, move_plane};
pub use stereo::{Stereo, StereoMode};
pub use visitor::CullVisitor;
