//! What the rarer node kinds hold: cameras, billboards, lights, clip planes, occluders, queries. Plain values.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3, DVec4};

use super::cull_settings::{CullSettings, Inherit};
use super::environment::{CameraEnvironment, CameraShadows};
use super::geometry::Drawable;
use super::pictures::{PictureSink, ReadBack};
use crate::math::Aabb;
use crate::state::{Light, TexGen, TextureObject};

/// Whether what a node holds is given in the frame it hangs in or in the eye's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReferenceFrame {
    /// In the frame of the nodes above.
    #[default]
    Relative,
    /// In the eye's frame: what is above does not move it, and its bound does not cull it.
    Absolute,
}

/// How a [`Billboard`] turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum BillboardMode {
    /// Parallel to the screen, its z axis up in the picture.
    #[default]
    PointRotEye,
    /// Its normal towards the eye, turned the shortest way.
    PointRotWorld,
    /// Turned about `axis` (unit, in the node's frame) only, its normal as near to the eye as that allows.
    AxialRot {
        /// Axis in the node's frame.
        axis: DVec3,
    },
}

impl BillboardMode {
    /// The map of a drawable at a position of the node's frame, seen from `eye` there.
    pub(crate) fn eye_from_drawable(self, eye_from_node: &DAffine3, eye: DVec3, position: DVec3) -> DAffine3 {
        let linear = eye_from_node.matrix3;
        let to_eye = (eye - position).normalize_or(DVec3::NEG_Y);
        let matrix3 = match self {
            // Right, away from the eye, up.
            Self::PointRotEye => {
                let scale = DVec3::new(linear.x_axis.length(), linear.y_axis.length(), linear.z_axis.length());
                DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y) * DMat3::from_diagonal(scale)
            }
            Self::PointRotWorld => linear * DMat3::from_quat(DQuat::from_rotation_arc(DVec3::NEG_Y, to_eye)),
            Self::AxialRot { axis } => {
                let axis = axis.normalize_or(DVec3::Z);
                let across = to_eye - axis * axis.dot(to_eye);
                let front = across.try_normalize().unwrap_or_else(|| axis.any_orthonormal_vector());
                linear * DMat3::from_cols((-front).cross(axis), -front, axis)
            }
        };
        DAffine3 { matrix3, translation: eye_from_node.transform_point3(position) }
    }

    /// How far a drawable reaches from its position along the node's axes, wherever it turns to; `linear` is the map of
    /// the node.
    pub(crate) fn reach(self, linear: &DMat3, bounds: &Aabb) -> DVec3 {
        let farthest = |scale: DVec3| bounds.corners().map(|c| (c * scale).length()).into_iter().fold(0.0, f64::max);
        // Parallel to the screen its own axes keep the node's scales, in whatever direction these are there: a ball about
        // it is an ellipsoid of the node.
        if self == Self::PointRotEye {
            let scale = DVec3::new(linear.x_axis.length(), linear.y_axis.length(), linear.z_axis.length());
            let inverse = linear.inverse();
            let rows = DVec3::new(inverse.row(0).length(), inverse.row(1).length(), inverse.row(2).length());
            let reach = farthest(scale) * rows;
            if reach.is_finite() {
                return reach;
            }
        }
        DVec3::splat(farthest(DVec3::ONE))
    }
}

/// Drawables that turn towards the eye. Each has its pivot at its own origin, looks along -y and has z up.
#[derive(Clone, Debug)]
pub struct Billboard {
    /// How they turn.
    pub mode: BillboardMode,
    /// Position in the node's frame and shape of each.
    pub drawables: Vec<(DVec3, Drawable)>,
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

/// When a camera in the graph is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RenderOrder {
    /// Before the stage it hangs in; lower numbers first.
    PreRender(i32),
    /// Inside it: another view and projection for the nodes below.
    Nested,
    /// After it; lower numbers first.
    PostRender(i32),
}

/// What a camera in the graph draws into.
#[derive(Clone, Debug, Default)]
pub struct CameraTarget {
    /// Colour attachments by location. Without any, and without depth, it is the target of the stage that the camera was met
    /// in.
    pub colors: Vec<Attachment>,
    /// Depth, to be sampled later; without one a depth buffer of the camera's own is used. Of several samples it gets the
    /// first one's depth and stencil, a depth that something has, where the stage was drawn.
    pub depth: Option<Attachment>,
    /// Samples a pixel, 1 or 4; resolved into the colour attachments. A camera that does not clear its colours goes on
    /// with what these hold, the same in all samples of a pixel where an earlier frame drew it. One that does not clear its
    /// depth goes on with what was drawn in this frame with as many samples; that of an earlier frame is cleared.
    pub samples: u32,
    /// Where the first colour attachment is copied to after each draw, with what cameras below draw over it; without waiting.
    pub read_back: Option<Arc<PictureSink>>,
    /// The same of other colour attachments, with their locations.
    pub read_back_of: Vec<(usize, Arc<PictureSink>)>,
    /// The same of [`Self::depth`], whose pictures have [`Depth32`](crate::state::TextureFormat::Depth32): see
    /// [`Picture::depth`](super::Picture::depth). Depth of `Depth24Stencil8` cannot be copied.
    pub read_back_depth: Option<Arc<PictureSink>>,
    /// The same of the stencil in [`Self::depth`], whose pictures have [`R8`](crate::state::TextureFormat::R8).
    pub read_back_stencil: Option<Arc<PictureSink>>,
}

impl CameraTarget {
    /// Width and height, where something is attached.
    pub fn size_px(&self) -> Option<[u32; 2]> {
        let first = self.colors.first().or(self.depth.as_ref())?;
        let [width, height, _] = first.texture.level_size(first.level);
        Some([width, height])
    }

    /// What is copied, and where to.
    pub(crate) fn read_backs(&self) -> impl Iterator<Item = (ReadBack, &Arc<PictureSink>)> {
        let first = self.read_back.iter().map(|sink| (ReadBack::Color(0), sink));
        let others = self.read_back_of.iter().map(|(location, sink)| (ReadBack::Color(*location), sink));
        let depth = self.read_back_depth.iter().map(|sink| (ReadBack::Depth, sink));
        let stencil = self.read_back_stencil.iter().map(|sink| (ReadBack::Stencil, sink));
        first.chain(others).chain(depth).chain(stencil)
    }
}

/// A part of a texture to draw into.
#[derive(Clone, Debug)]
pub struct Attachment {
    /// Made with [`TextureObject::target`].
    pub texture: Arc<TextureObject>,
    /// Mip level.
    pub level: u32,
    /// Array layer or cube face.
    pub layer: u32,
}

impl Attachment {
    /// Level 0, layer 0 of a texture.
    pub fn new(texture: Arc<TextureObject>) -> Self {
        Self { texture, level: 0, layer: 0 }
    }
}

/// Sets near and far anew: called with what cull found (metres in front of the eye), returns what to use.
pub type ClampProjection = fn(near_m: f64, far_m: f64) -> (f64, f64);

/// A camera in the graph.
#[derive(Clone, Debug)]
pub struct CameraNode {
    /// When it is drawn.
    pub order: RenderOrder,
    /// Eye from the node's frame (relative) or from the world (absolute).
    pub view: DAffine3,
    /// Absolute: `view` replaces everything above. Relative: it comes below it.
    pub frame: ReferenceFrame,
    /// Reversed-Z projection; `None` keeps the one above.
    pub projection: Option<DMat4>,
    /// x, y, width, height in pixels of the target, origin upper left; `None`: all of its own target, or what the view has
    /// of it that the camera was met in.
    pub viewport_px: Option<[u32; 4]>,
    /// Linear colour to clear with; `None` keeps what is there. Nested cameras clear nothing.
    pub clear_color: Option<[f32; 4]>,
    /// Clear depth before drawing (to infinitely far). What is not cleared is what was drawn before in this frame into the
    /// same target, or what a depth texture holds; a depth buffer of the target's own is another's from one frame to the
    /// next.
    pub clear_depth: bool,
    /// Show the whole scene, besides what is below it: mirrors, maps and other views of one world, its paged content with
    /// the tiles that the camera's own eye asks for. Levels of detail do not cross-fade in its picture. Of cameras that
    /// show the scene none is drawn in another's picture. Nested cameras show it among the things of the picture that
    /// they are met in: compared with the depths there, without its occluders, background, sky and water.
    pub shows_scene: bool,
    /// What it draws into; `None`: what the stage draws into that the camera was met in.
    pub target: Option<Arc<CameraTarget>>,
    /// Light, air, sky and water of its picture.
    pub environment: CameraEnvironment,
    /// Shadows of the sun in its picture.
    pub shadows: CameraShadows,
    /// What it culls.
    pub settings: CullSettings,
    /// Which of the settings come from above.
    pub inherit: Inherit,
    /// Changes near and far when they are computed.
    pub clamp_projection: Option<ClampProjection>,
    /// What is called while it is drawn.
    pub callbacks: Option<DrawHook>,
}

impl CameraNode {
    /// A camera of an order, with everything from above but its view: the identity, relative.
    pub fn new(order: RenderOrder) -> Self {
        Self {
            order,
            view: DAffine3::IDENTITY,
            frame: ReferenceFrame::Relative,
            projection: None,
            viewport_px: None,
            clear_color: Some([0.0, 0.0, 0.0, 1.0]),
            clear_depth: true,
            shows_scene: false,
            target: None,
            environment: CameraEnvironment::default(),
            shadows: CameraShadows::default(),
            settings: CullSettings::default(),
            inherit: Inherit::ALL,
            clamp_projection: None,
            callbacks: None,
        }
    }

    /// A camera drawn before the stage it hangs in, into a texture of a size.
    pub fn to_texture(texture: Arc<TextureObject>, view: DAffine3, projection: DMat4) -> Self {
        let colors = vec![Attachment::new(texture)];
        Self {
            view,
            frame: ReferenceFrame::Absolute,
            projection: Some(projection),
            target: Some(Arc::new(CameraTarget { colors, samples: 1, ..CameraTarget::default() })),
            ..Self::new(RenderOrder::PreRender(0))
        }
    }
}

pub use crate::state::DrawHook;

/// A convex planar polygon that hides what is behind it; OSG's `ConvexPlanarOccluder`.
#[derive(Clone, Debug, Default)]
pub struct ConvexPlanarOccluder {
    /// Corners in the node's frame, either way round.
    pub corners: Vec<DVec3>,
    /// Convex holes in it: what may be seen through one is not hidden.
    pub holes: Vec<Vec<DVec3>>,
}

/// Asks the adapter how many samples of its box are seen, and skips its children while none are. One eye asks, the first
/// that met the node and still does: what it does not see another may, so that others draw what is below. Cameras in the
/// graph that show the scene neither ask nor heed what is answered. A node below which something is culled by no bound (a
/// light, a camera, what is in the eye's frame) asks nothing and hides nothing.
#[derive(Clone, Debug)]
pub struct OcclusionQueryNode {
    /// Hidden when fewer samples pass.
    pub visibility_threshold: u32,
    /// Frames between two queries of the same node.
    pub query_frames: u32,
    /// Queries in a row that must fail before it is hidden; one that passes shows it again.
    pub failures_to_hide: u32,
    /// What the queries found.
    pub results: Arc<OcclusionResults>,
}

impl Default for OcclusionQueryNode {
    fn default() -> Self {
        Self { visibility_threshold: 1, query_frames: 2, failures_to_hide: 2, results: Arc::default() }
    }
}

/// Results of an [`OcclusionQueryNode`].
#[derive(Debug, Default)]
pub struct OcclusionResults {
    /// Failed queries in a row; written by the draw thread, read by cull.
    failures: AtomicU32,
    /// Samples of the last query; written by the draw thread.
    samples: AtomicU32,
    /// Frame of the last query; written by cull.
    queried: AtomicU32,
    /// Frame of the last query that was answered; written after `failures` by whoever writes that.
    answered: AtomicU32,
    /// The last query was not answered yet; written by cull, and by the draw thread after all that it writes.
    is_awaited: AtomicBool,
    /// What cull last decided.
    is_hidden: AtomicBool,
    /// The eye that asks; written by cull.
    eye: AtomicU32,
}

/// An eye that has not asked for so many frames asks no more.
const IDLE_FRAMES: u32 = 120;

impl OcclusionResults {
    /// Samples that passed in the last query that has arrived.
    pub fn samples(&self) -> u32 {
        self.samples.load(Ordering::Relaxed)
    }

    /// Failed queries in a row.
    pub fn failures(&self) -> u32 {
        self.failures.load(Ordering::Relaxed)
    }

    /// True for the eye that asks: the first that met the node, as long as it does. Others draw what is below.
    pub(crate) fn are_of(&self, eye: u32, frame: u32) -> bool {
        let asking = self.eye.load(Ordering::Relaxed);
        if asking == eye {
            return true;
        }
        let is_idle = frame.abs_diff(self.queried.load(Ordering::Relaxed)) > IDLE_FRAMES;
        if asking == 0 || is_idle {
            self.eye.store(eye, Ordering::Relaxed);
            self.failures.store(0, Ordering::Relaxed);
        }
        asking == 0 || is_idle
    }

    /// True once every so many frames, and where frames stand still once the last query was answered; notes the frame.
    pub(crate) fn is_due(&self, frame: u32, every: u32) -> bool {
        let last = self.queried.load(Ordering::Relaxed);
        let is_answered_still = last == frame && !self.is_awaited.load(Ordering::Acquire);
        let due = last == 0 || frame.wrapping_sub(last) >= every.max(1) || is_answered_still;
        if due {
            self.is_awaited.store(true, Ordering::Relaxed);
            self.queried.store(frame.max(1), Ordering::Relaxed);
        }
        due
    }

    /// A query that was due could not be made: it is due again, and what was hidden shows, if need be.
    pub(crate) fn was_not_asked(&self, shows: bool, frame: u32) {
        self.queried.store(0, Ordering::Relaxed);
        if shows {
            self.failures.store(0, Ordering::Relaxed);
            self.answered.store(frame, Ordering::Release);
        }
    }

    /// The answer to a query of a frame, from the draw thread.
    pub(crate) fn answered(&self, samples: u64, threshold: u32, frame: u32) {
        self.samples.store(u32::try_from(samples).unwrap_or(u32::MAX), Ordering::Relaxed);
        if samples >= u64::from(threshold) {
            self.failures.store(0, Ordering::Relaxed);
        } else {
            self.failures.fetch_add(1, Ordering::Relaxed);
        }
        self.answered.store(frame, Ordering::Release);
        self.is_awaited.store(false, Ordering::Release);
    }

    /// Whether a frame leaves out what is below, and how many frames ago that was asked; all of them while more answers
    /// may hide it, and `u32::MAX` where the frame before had it otherwise. Cull.
    pub(crate) fn decide(&self, frame: u32, failures_to_hide: u32) -> (bool, u32) {
        let answered = self.answered.load(Ordering::Acquire);
        let failures = self.failures();
        let is_hidden = failures >= failures_to_hide;
        let age = match self.is_hidden.swap(is_hidden, Ordering::Relaxed) {
            was_hidden if was_hidden != is_hidden => u32::MAX,
            _ if !is_hidden && failures > 0 => frame,
            _ => frame.saturating_sub(answered),
        };
        (is_hidden, age)
    }
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

/// The directions in which a drawable's faces look: it is culled from where none can be seen; OSG's
/// `ClusterCullingCallback`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalCone {
    /// Middle, in the drawable's frame.
    pub control_point: DVec3,
    /// Mean direction of the faces, unit.
    pub normal: DVec3,
    /// Culled where the cosine between `normal` and the direction to the eye is smaller.
    pub least_cosine: f64,
    /// Nearer eyes see it always, metres.
    pub radius_m: f64,
}
