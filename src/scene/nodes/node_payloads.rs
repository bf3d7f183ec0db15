//! The payloads of the simpler rare node kinds: lights, clip planes, occluders, cull callbacks. Plain values.

use std::sync::Arc;

use glam::{DVec3, DVec4};

use crate::state::{Light, StateSet, TexGen};

/// The frame in which the payload of a node is given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReferenceFrame {
    /// The frame of the nodes above.
    #[default]
    Relative,
    /// The eye's frame: nodes above do not move it, and its bound does not cull it.
    Absolute,
}

/// A light at a position of the graph. It shines on everything of the render stage for which
/// [`Mode::Light`](crate::state::Mode::Light) of its number is on.
#[derive(Clone, Debug)]
pub struct LightSource {
    /// The light; its position and direction are in the node's frame.
    pub light: Light,
    /// The frame of the position.
    pub frame: ReferenceFrame,
}

/// Lights that shine only on what is below their node, besides the sun and the lights of state sets. They also shine on
/// pages that are attached below, but not on what a camera below draws into a separate stage. They cast no shadows.
///
/// Metallic-roughness surfaces reflect [`Light::diffuse`] as glTF defines it and [`Light::ambient`] with their diffuse
/// colour. They ignore [`Light::specular`].
#[derive(Clone, Debug, Default)]
pub struct LocalLights {
    /// The lights, in the frame of the node; at most [`LocalLights::MAX`] shine, the first ones. Their numbers are ignored.
    /// If there is room, lights of nodes above follow.
    pub lights: Vec<Light>,
}

impl LocalLights {
    /// The maximum number of local lights that shine on one drawable.
    pub const MAX: usize = 16;
}

/// Planes that clip everything for which [`Mode::ClipPlane`](crate::state::Mode::ClipPlane) of their number is on. The modes
/// are on for the node's children.
#[derive(Clone, Debug)]
pub struct ClipNode {
    /// The number (0 to 5) and equation of each plane: a point `p` of the node's frame is kept if `normal . p + d >= 0`.
    pub planes: Vec<(u8, DVec4)>,
    /// The frame of the planes.
    pub frame: ReferenceFrame,
}

/// The frame of a [`TexGen`] with eye-linear planes: the planes are fixed to the node instead of the eye.
#[derive(Clone, Debug)]
pub struct TexGenNode {
    /// The texture unit.
    pub unit: u8,
    /// The generator, for everything of the render stage that has the unit's eye-linear generation on.
    pub texgen: TexGen,
}

/// Replaces how the surrounding camera clears the target of its render stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClearNode {
    /// The linear clear colour; `None` keeps the contents of the target.
    pub color: Option<[f32; 4]>,
}

/// A convex planar polygon that hides everything behind it; OSG's `ConvexPlanarOccluder`.
#[derive(Clone, Debug, Default)]
pub struct ConvexPlanarOccluder {
    /// The corners in the node's frame, in either winding.
    pub corners: Vec<DVec3>,
    /// Convex holes in the polygon. Anything that may be visible through a hole is not hidden.
    pub holes: Vec<Vec<DVec3>>,
}

/// The decision of a cull callback about its node or drawable.
#[derive(Clone, Debug, Default)]
pub enum CullAction {
    /// It is visited as if it had no callback.
    #[default]
    Traverse,
    /// It is not drawn, and neither is anything below.
    Skip,
    /// It is visited once for each pass, in their order; see [`CullPass`].
    Passes(Arc<[CullPass]>),
}

/// The state sets that one visit of a node or drawable pushes, outermost first: they hold below its own state set and above
/// those below it. A callback of OSG that pushes state sets, calls `traverse` and pops them returns a pass for each such call.
///
/// Cull finds state sets by identity, so that the callback returns the same ones in each frame. Each pass of a node costs the
/// time to look up the states of its page once more.
pub type CullPass = Vec<Arc<StateSet>>;

impl CullAction {
    /// Returns true if the node or drawable is visited at all.
    pub(crate) fn visits(&self) -> bool {
        match self {
            Self::Traverse => true,
            Self::Skip => false,
            Self::Passes(passes) => !passes.is_empty(),
        }
    }
}

/// The arguments of a cull callback.
#[derive(Clone, Copy, Debug)]
pub struct CullInfo {
    /// The frame number.
    pub frame: u32,
    /// The eye's position in the page's frame.
    pub eye_in_page: DVec3,
    /// The distance of the eye from the centre of the bound, metres of the page's frame; infinite without a bound.
    pub distance_m: f64,
}

/// A function that cull calls before it visits a node or drawable, on the thread that culls and before bounds are tested. It
/// must not block.
#[derive(Clone)]
pub struct CullCallback(pub Arc<dyn Fn(&CullInfo) -> CullAction + Send + Sync>);

impl std::fmt::Debug for CullCallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("CullCallback")
    }
}
