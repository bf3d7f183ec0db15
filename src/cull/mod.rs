//! Stand-in for the cull module's output types, until that module is merged.

use glam::{DAffine3, DMat4};

use crate::scene::DrawSlot;
use crate::state::SortMode;

/// The camera a stage was culled for.
#[derive(Clone, Debug)]
pub struct CullCamera {
    /// Eye from world.
    pub eye_from_world: DAffine3,
    /// Reversed-Z infinite projection.
    pub clip_from_eye: DMat4,
    /// Width and height.
    pub viewport_px: [u32; 2],
    /// LOD scale.
    pub lod_scale: f64,
    /// Pixels of error.
    pub max_sse_px: f64,
}

/// Inherited state, resolved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResolvedState {
    /// Linear factor.
    pub color: [f32; 4],
    /// Depth write.
    pub depth_write: bool,
    /// Wireframe.
    pub wireframe: bool,
}

/// One leaf.
#[derive(Clone, Copy, Debug)]
pub struct RenderLeaf {
    /// What is drawn.
    pub slot: DrawSlot,
    /// Index into `state_sets`.
    pub state: u32,
    /// Index into `eye_from_drawable`.
    pub matrix: u32,
    /// Distance.
    pub depth: f32,
}

/// A bin.
#[derive(Clone, Debug)]
pub struct RenderBin {
    /// Number.
    pub number: i32,
    /// Order.
    pub sort: SortMode,
    /// Leaves in draw order.
    pub leaves: Vec<RenderLeaf>,
}

/// What cull decided.
#[derive(Clone, Debug)]
pub struct RenderStage {
    /// Camera.
    pub camera: CullCamera,
    /// Rows of 3x4 affine maps.
    pub eye_from_drawable: Vec<[[f32; 4]; 3]>,
    /// States.
    pub state_sets: Vec<ResolvedState>,
    /// Bins.
    pub bins: Vec<RenderBin>,
}
