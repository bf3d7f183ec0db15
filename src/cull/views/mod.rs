//! The views of a stage: a camera with the planes and measures that nodes and tiles are tested against. Culling thread.
//!
//! A stage begins with the view of its camera. Projection nodes and nested cameras add views, which the traversal pushes and
//! pops as it enters and leaves them.

mod planes;
mod view;
mod view_stack;

pub(super) use planes::{EyePlanes, GridPlanes, Planes, depth_row};
pub(super) use view::{DepthRange, View};
pub(super) use view_stack::ViewStack;
