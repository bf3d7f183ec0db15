//! The intersection traversal: what it visits, and what it finds.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::surface::Surface;
use super::walk::{Candidate, Probe, Rules, candidates, node_of_drawable};
use crate::scene::{LodRanges, NodeId, Scene};

/// Which level of detail is intersected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LodSelection {
    /// The finest that could be drawn: a tile's children as soon as all of them are loaded; of a Lod node what is
    /// shown nearest. OSG's `USE_HIGHEST_LEVEL_OF_DETAIL`.
    #[default]
    Highest,
    /// Tiles down to this depth (root 0) or to the finest loaded above it; of a Lod node what is shown nearest.
    Level(u32),
    /// What [`IntersectionVisitor::eye`] sees, by its error limit: what is drawn. Without an eye as `Highest`. OSG's
    /// `USE_EYE_POINT_FOR_LOD_LEVEL_SELECTION`.
    AsSeen,
}

/// The eye whose picture is intersected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyePoint {
    /// Eye space (looking down -z, y up) to world, without scale.
    pub world_from_eye: DAffine3,
    /// Pixels that one metre covers at a distance of one metre; at any distance where rays are parallel.
    pub px_per_radian: f64,
    /// The projection is no perspective one: errors are seen as large from anywhere.
    pub is_parallel: bool,
    /// A tile whose error projects to more pixels is refined.
    pub max_sse_px: f64,
    /// Distances are multiplied with it where levels are chosen.
    pub lod_scale: f64,
}

impl EyePoint {
    /// Place in the world.
    pub fn position(&self) -> DVec3 {
        self.world_from_eye.translation
    }

    /// Distances at which tiles are refined, as cull has them.
    pub(super) fn ranges(&self) -> LodRanges {
        LodRanges::new(self.px_per_radian, self.max_sse_px, self.lod_scale, self.is_parallel)
    }
}

/// Which intersections an intersector keeps. Of pictures drawn over each other the uppermost is the nearest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum IntersectionLimit {
    /// All of them.
    #[default]
    NoLimit,
    /// The nearest of each drawable.
    OnePerDrawable,
    /// Any one: whether there is something at all.
    One,
    /// The nearest.
    Nearest,
}

/// A primitive that an intersector meets.
#[derive(Clone, Debug)]
pub struct Intersection {
    /// From the root page's first node, across the pages between, to the node that holds the drawable.
    pub node_path: Arc<[NodeId]>,
    /// Number of the drawable in the page of the last node.
    pub drawable: u32,
    /// Number of the primitive in the drawable: of a mesh by its indices, of a height tile two a cell (the
    /// south-eastern one first), cells row by row from the south-west.
    pub primitive: u32,
    /// Its corners: of a mesh indices into the vertices, of a height tile row by row from the south-west. The last
    /// one repeats where there are fewer than three.
    pub vertices: [u32; 3],
    /// Shares of the corners in the point: what to blend their attributes by.
    pub weights: [f64; 3],
    /// Where along the intersector it is: of a segment 0 to 1, of a ray in metres, of a polytope the least distance
    /// from its reference plane. Of what another projection draws: where in the picture itself it would have that depth.
    pub ratio: f64,
    /// The largest distance from the reference plane of what a polytope meets of it; else as `ratio`.
    pub max_ratio: f64,
    /// The drawable's frame to the world's.
    pub world_from_local: DAffine3,
    /// The point in the drawable's frame; of a polytope the middle of what it meets of the primitive.
    pub local_point: DVec3,
    /// Unit normal of the primitive in the drawable's frame, on the side from which its corners run counter-clockwise,
    /// of height tiles upwards; zero for lines and points.
    pub local_normal: DVec3,
}

impl Intersection {
    /// The point in the world, metres; below an absolute camera with a picture of its own, in the world of that camera.
    pub fn world_point(&self) -> DVec3 {
        self.world_from_local.transform_point3(self.local_point)
    }

    /// The unit normal in the world; zero for lines and points.
    pub fn world_normal(&self) -> DVec3 {
        (self.world_from_local.matrix3.inverse().transpose() * self.local_normal).normalize_or_zero()
    }

    /// The node that holds the drawable.
    pub fn node(&self) -> Option<NodeId> {
        self.node_path.last().copied()
    }
}

/// An intersection as the intersectors find it.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    pub candidate: Candidate,
    pub primitive: u32,
    pub vertices: [u32; 3],
    pub weights: [f64; 3],
    pub ratio: f64,
    pub max_ratio: f64,
    pub local_point: DVec3,
    pub local_normal: DVec3,
}

/// What is common to intersectors.
pub trait Intersect: Probe {
    /// Forgets what was found.
    fn clear(&mut self);
    /// True where neither this candidate nor those behind it could change what is kept.
    fn is_done(&self, candidate: &Candidate) -> bool;
    /// Meets a drawable.
    fn meet(&mut self, candidate: &Candidate, surface: &Surface);
    /// What was met, and where it goes.
    fn results(&mut self) -> (&mut Vec<Met>, &mut Vec<Intersection>);
}

/// A shape to intersect the scene with: [`super::LineSegmentIntersector`], [`super::RayIntersector`],
/// [`super::PolytopeIntersector`].
pub trait Intersector: Intersect {}

/// Goes through the scene with an intersector. Any thread that may read the scene; keeps memory from one traversal to
/// the next.
///
/// Follows masks, transforms, switches and levels of detail as cull does. Cull callbacks are not asked, clip planes and
/// occlusion queries do not hide, skirts of height tiles are not met. Billboards and what hangs in the eye's frame are
/// met where there is an eye.
///
/// What is below a Projection, or a camera with a projection or viewport of its own, is met by intersectors that were
/// given at a place of a picture ([`WindowView`](crate::scene::WindowView)): where it shows there. Intersectors of the
/// world do not meet it. A camera that draws into a texture shows where the texture does; what it draws is never met.
///
/// A drawable is met by its [`KdTree`](crate::scene::KdTree), without one by its payload, as long as that is in the page;
/// [`Self::unmet_drawables`] counts those that have neither.
#[derive(Debug)]
pub struct IntersectionVisitor {
    /// Only nodes with `mask & traversal_mask != 0` are visited.
    pub traversal_mask: u32,
    /// Which tiles and Lod children are met.
    pub lod_selection: LodSelection,
    /// The eye of [`LodSelection::AsSeen`] and of billboards.
    pub eye: Option<EyePoint>,
    found: Vec<Candidate>,
    unmet: usize,
}

impl Default for IntersectionVisitor {
    fn default() -> Self {
        Self {
            traversal_mask: u32::MAX,
            lod_selection: LodSelection::default(),
            eye: None,
            found: Vec::new(),
            unmet: 0,
        }
    }
}

impl IntersectionVisitor {
    /// Everything, at the highest level.
    pub fn new() -> Self {
        Self::default()
    }

    /// What an eye sees, as it sees it.
    pub fn as_seen_from(eye: EyePoint) -> Self {
        Self { lod_selection: LodSelection::AsSeen, eye: Some(eye), ..Self::default() }
    }

    /// Replaces what the intersector holds by what it meets now, nearest first.
    pub fn traverse(&mut self, scene: &Scene, intersector: &mut impl Intersector) {
        intersector.clear();
        self.unmet = 0;
        candidates(scene, &self.rules(), intersector, &mut self.found);
        for candidate in &self.found {
            if intersector.is_done(candidate) {
                break;
            }
            match scene.page_at(candidate.place).and_then(|page| Surface::of(page, candidate.drawable)) {
                Some(surface) => intersector.meet(candidate, &surface),
                None => self.unmet += 1,
            }
        }
        let (met, results) = intersector.results();
        met.sort_by(|a, b| a.candidate.layer.cmp(&b.candidate.layer).then(a.ratio.total_cmp(&b.ratio)));
        results.reserve(met.len());
        for m in met.iter() {
            let last = results.last().filter(|r: &&Intersection| {
                let of_page = r.node().is_some_and(|n| n.page.slot == m.candidate.place);
                of_page && r.drawable == m.candidate.drawable
            });
            let node_path = last.map_or_else(|| node_path(scene, &m.candidate), |r| r.node_path.clone());
            results.push(Intersection {
                node_path,
                drawable: m.candidate.drawable,
                primitive: m.primitive,
                vertices: m.vertices,
                weights: m.weights,
                ratio: m.ratio,
                max_ratio: m.max_ratio,
                world_from_local: m.candidate.world_from_drawable,
                local_point: m.local_point,
                local_normal: m.local_normal.normalize_or_zero(),
            });
        }
    }

    /// Drawables whose boxes the last traversal met, but that have neither a tree nor a payload.
    pub fn unmet_drawables(&self) -> usize {
        self.unmet
    }

    pub(super) fn rules(&self) -> Rules {
        Rules { mask: self.traversal_mask, lods: self.lod_selection, eye: self.eye }
    }
}

/// From the root to the node that holds a drawable.
fn node_path(scene: &Scene, candidate: &Candidate) -> Arc<[NodeId]> {
    let mut path = Vec::new();
    let page = scene.page_id_at(candidate.place);
    let node = scene.page_at(candidate.place).map(|p| node_of_drawable(p, candidate.drawable));
    let mut at = node.map(|index| NodeId { page, index });
    while let Some(NodeId { page: id, index }) = at {
        let Some(page) = scene.page(id) else { break };
        path.extend(page.path_to_root(index).map(|(index, _)| NodeId { page: id, index }));
        at = scene.slot_of(id);
    }
    path.reverse();
    path.into()
}
