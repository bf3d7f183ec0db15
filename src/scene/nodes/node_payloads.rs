//! The payloads of the simpler rare node kinds: lights, clip planes, occluders, cull callbacks. Plain values.

use std::sync::Arc;

use glam::{DVec3, DVec4};

use crate::state::{Light, TexGen};

/// Whether what a node holds is given in the frame it hangs in or in the eye's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReferenceFrame {
    /// In the frame of the nodes above.
    #[default]
    Relative,
    /// In the eye's frame: what is above does not move it, and its bound does not cull it.
    Absolute,
}

/// A light at a place of the graph. It shines on everything of the render stage for which
/// [`Mode::Light`](crate::state::Mode::Light) of its number is on.
#[derive(Clone, Debug)]
pub struct LightSource {
    /// The light; its position and direction are in the node's frame.
    pub light: Light,
    /// Frame of the position.
    pub frame: ReferenceFrame,
}

/// Planes that cut what is drawn where [`Mode::ClipPlane`](crate::state::Mode::ClipPlane) of their number is on; it is
/// on for the node's children.
#[derive(Clone, Debug)]
pub struct ClipNode {
    /// Number (0 to 5) and plane: a point `p` of the node's frame is kept where `normal . p + d >= 0`.
    pub planes: Vec<(u8, DVec4)>,
    /// Frame of the planes.
    pub frame: ReferenceFrame,
}

/// Where a [`TexGen`] of eye-linear planes has its frame: the planes are fixed to the node instead of the eye.
#[derive(Clone, Debug)]
pub struct TexGenNode {
    /// Texture unit.
    pub unit: u8,
    /// The generator, for everything of the render stage that has the unit's eye-linear generation on.
    pub texgen: TexGen,
}

/// Clears the target of the render stage it hangs in otherwise than its camera says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClearNode {
    /// Linear colour to clear with; `None` keeps what is in the target.
    pub color: Option<[f32; 4]>,
}

/// A convex planar polygon that hides what is behind it; OSG's `ConvexPlanarOccluder`.
#[derive(Clone, Debug, Default)]
pub struct ConvexPlanarOccluder {
    /// Corners in the node's frame, either way round.
    pub corners: Vec<DVec3>,
    /// Convex holes in it: what may be seen through one is not hidden.
    pub holes: Vec<Vec<DVec3>>,
}

/// What a cull callback decides about its node.
#[derive(Clone, Debug, Default)]
pub enum CullAction {
    /// As if there were no callback.
    #[default]
    Traverse,
    /// The node and all below it are not drawn.
    Skip,
}

/// What a cull callback is told.
#[derive(Clone, Copy, Debug)]
pub struct CullInfo {
    /// The frame.
    pub frame: u32,
    /// Place of the eye in the page's frame.
    pub eye_in_page: DVec3,
    /// Distance of the eye from the middle of the node's bound, metres of the page's frame; infinite without a bound.
    pub distance_m: f64,
}

/// Asked by cull each time a node is about to be visited, on the thread that culls; must not block.
#[derive(Clone)]
pub struct CullCallback(pub Arc<dyn Fn(&CullInfo) -> CullAction + Send + Sync>);

impl std::fmt::Debug for CullCallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("CullCallback")
    }
}
