//! The names that the first hundred lines of an application need: `use terrane::prelude::*;`.
//!
//! It has the viewer and its configuration, the types of which scenes are built, and the vector types of their signatures.
//! Everything else is imported from its module, for example manipulators from
//! [`viewer::manipulators`](crate::viewer::manipulators).

pub use glam::{DAffine3, DMat4, DQuat, DVec2, DVec3};

pub use crate::gpu::{ContextTraits, GraphicsContext};
pub use crate::math::{BoundingSphere, BoundingVolume, WGS84};
pub use crate::pager::PagerConfig;
pub use crate::scene::{Drawable, Environment, Material, Mesh, Node, NodeId, NodeKind, Page, PageId, Scene, Sky};
pub use crate::state::{Mode, StateSet, StateValue};
pub use crate::viewer::{
    Camera, CompositeViewer, ContextId, FieldOfView, FrameStamp, Slave, ThreadingModel, View, ViewArea, ViewFrom,
    Viewer, ViewerConfig, ViewerError,
};
#[cfg(feature = "window")]
pub use crate::viewer::{WindowOptions, has_display, run_window};
