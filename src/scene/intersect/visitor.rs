//! The intersection traversal: visits the scene with an intersector. Any thread that may read the scene.

use std::sync::Arc;

use super::intersection::{Intersection, Intersector};
use super::probe::Candidate;
use super::selection::{EyePoint, LodSelection, Rules};
use super::surface::Surface;
use super::walk::{candidates, node_of_drawable};
use crate::scene::graph::Scene;
use crate::scene::id::NodeId;

/// Intersects a scene with an intersector. Any thread that may read the scene; memory is reused by the next traversal.
///
/// The traversal follows masks, transforms, switches and levels of detail as culls do. It ignores cull callbacks, clip
/// planes, occlusion queries and the skirts of height tiles. Billboards and geometry in the eye's frame are included if
/// there is an eye.
///
/// Geometry below a Projection, or below a camera with a separate projection or viewport, is met only by intersectors
/// that were given at a position of an image ([`WindowView`](crate::scene::WindowView)). They meet it at the position
/// where it is visible. Geometry that a camera draws into a texture is never met.
///
/// The traversal tests the [`KdTree`](crate::scene::KdTree) of a drawable, or else its payload while the page has it;
/// [`Self::unmet_drawables`] counts drawables that have neither.
#[derive(Debug)]
pub struct IntersectionVisitor {
    /// Only nodes with `mask & traversal_mask != 0` are visited.
    pub traversal_mask: u32,
    /// Which tiles and Lod children are visited.
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
    /// Creates a visitor of everything, at the highest level of detail.
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates a visitor of what an eye sees, at the levels of detail that are drawn for it.
    pub fn as_seen_from(eye: EyePoint) -> Self {
        Self { lod_selection: LodSelection::AsSeen, eye: Some(eye), ..Self::default() }
    }

    /// Replaces the intersector's results by its intersections with the scene, nearest first.
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

    /// Returns the number of drawables whose boxes the last traversal met, but that have neither a tree nor a payload.
    pub fn unmet_drawables(&self) -> usize {
        self.unmet
    }

    pub(super) fn rules(&self) -> Rules {
        Rules { mask: self.traversal_mask, lods: self.lod_selection, eye: self.eye }
    }
}

/// Returns the path from the root to the node that holds a drawable.
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
