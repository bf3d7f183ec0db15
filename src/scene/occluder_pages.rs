//! The pages of a scene that have OccluderNodes: maintained as pages are attached and detached, read by culls.
//!
//! When occluders move, the sphere around them becomes infinite; it is fitted once for all changes of a frame, as the
//! bounds of nodes are.

use super::pages::{Page, RareNode};
use crate::math::{Aabb, BoundingSphere};

/// A page that has OccluderNodes, with a sphere that tells a cull whether to look at them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OccluderPage {
    /// The position of the page in the scene's page table.
    pub place: u32,
    /// A sphere around its occluders, in its frame; of infinite radius if some of them move with the eye.
    pub sphere: BoundingSphere,
    /// True if occluders were moved since the sphere was fitted.
    pub is_stale: bool,
}

impl OccluderPage {
    /// Fits the sphere around the occluders of a page.
    pub(super) fn new(place: u32, page: &Page) -> Self {
        let moves_with_eye = page.rare_nodes().iter().any(|s| matches!(s, RareNode::AbsoluteTransform));
        let corners = page.occluders().iter().flat_map(|record| {
            let page_from_node = page.transforms().page_from_node(record.transform);
            record.occluder.corners.iter().map(move |corner| page_from_node.transform_point3(*corner))
        });
        // An occluder that is not finite hides nothing.
        let mut sphere = Aabb::from_points(corners.filter(|c| c.is_finite())).bounding_sphere();
        if moves_with_eye {
            sphere.radius_m = f64::INFINITY;
        }
        Self { place, sphere, is_stale: false }
    }

    /// Notes that occluders were moved: culls look at each of them until the sphere is fitted again.
    pub(super) fn outdate(&mut self) {
        (self.sphere.radius_m, self.is_stale) = (f64::INFINITY, true);
    }
}
