//! The output of cull: moved to the draw thread by value, and back for reuse.

use super::CullCamera;
use super::sort::Spare;
use crate::scene::{DrawSlot, NodeId};
use crate::state::{ResolvedState, SortMode};

/// Something to draw; 16 bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderLeaf {
    /// Where the context keeps the drawable; `DrawSlot::NONE` is skipped by the renderer.
    pub slot: DrawSlot,
    /// Index into [`RenderStage::state_sets`].
    pub state: u32,
    /// Index into [`RenderStage::eye_from_drawable`].
    pub matrix: u32,
    /// Metres in front of the eye, of the bound's centre.
    pub depth: f32,
}

/// Leaves with one number and order.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderBin {
    /// Bins are drawn in the order of their numbers.
    pub number: i32,
    /// The order that was asked for.
    pub sort: SortMode,
    /// Leaves in draw order.
    pub leaves: Vec<RenderLeaf>,
}

/// A page that is wanted and missing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageRequest {
    /// Where it belongs.
    pub slot: NodeId,
    /// Larger first: the error in pixels of what is shown instead, always below that of the tile above, so that
    /// coarse comes before fine. Tiles outside the frustum, needed so that their siblings can replace the parent,
    /// have a quarter.
    pub priority: f32,
    /// Error of the tile itself, in pixels, were it shown.
    pub error_px: f32,
}

/// What a cull did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CullCounters {
    /// Nodes tested; those in subtrees wholly inside are not visited.
    pub nodes_visited: u32,
    /// Drawables tested or taken.
    pub drawables_tested: u32,
    /// Leaves emitted.
    pub leaves: u32,
    /// Tiles tested.
    pub tiles_visited: u32,
    /// Tiles whose content is drawn.
    pub tiles_drawn: u32,
    /// Tiles that the wanted picture lacks and that can still be loaded; 0 once it is the wanted one.
    pub wanted_missing: u32,
}

/// What is drawn for a camera.
#[derive(Debug, Default)]
pub struct RenderStage {
    /// The camera that was culled for.
    pub camera: CullCamera,
    /// Rows of 3x4 affine maps, shared by index.
    pub eye_from_drawable: Vec<[[f32; 4]; 3]>,
    /// Indexed by [`RenderLeaf::state`].
    pub state_sets: Vec<ResolvedState>,
    /// Sorted by number.
    pub bins: Vec<RenderBin>,
    /// Missing pages, in the order met.
    pub requests: Vec<PageRequest>,
    /// Nearest depth of any leaf's bound, at least 0; 0 without leaves.
    pub near_m: f64,
    /// Farthest depth of any leaf's bound; 0 without leaves.
    pub far_m: f64,
    /// What the cull did.
    pub counters: CullCounters,
    pub(super) spare: Spare,
}

impl RenderStage {
    /// A stage without memory; the first culls make it.
    pub fn new() -> Self {
        Self::default()
    }
}
