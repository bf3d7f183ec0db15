//! The scene's list of pages with OccluderNodes: kept up as pages come and go, read by culls. Spheres of pages in which
//! some were moved are fitted once for all changes of a frame, as the bounds of nodes are; until then they are endless.

use super::page::{Page, Special};
use crate::math::{Aabb, BoundingSphere};

/// A page that has OccluderNodes, and what tells whether it is worth a look.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OccluderPage {
    /// In the scene's page table.
    pub place: u32,
    /// Around its occluders, in its frame; endless where some of them move with the eye.
    pub sphere: BoundingSphere,
    /// Some were moved.
    pub is_stale: bool,
}

impl OccluderPage {
    pub(super) fn new(place: u32, page: &Page) -> Self {
        let moves = page.specials.iter().any(|s| matches!(s, Special::AbsoluteTransform));
        let corners = page.occluders.iter().flat_map(|(_, transform, occluder)| {
            let page_from_node = page.transforms.page_from_node(*transform);
            occluder.corners.iter().map(move |corner| page_from_node.transform_point3(*corner))
        });
        // What is not finite hides nothing.
        let mut sphere = Aabb::from_points(corners.filter(|c| c.is_finite())).bounding_sphere();
        if moves {
            sphere.radius_m = f64::INFINITY;
        }
        Self { place, sphere, is_stale: false }
    }

    /// Some were moved: they are looked at one by one.
    pub(super) fn outdate(&mut self) {
        (self.sphere.radius_m, self.is_stale) = (f64::INFINITY, true);
    }
}

impl Page {
    /// Whether there are OccluderNodes below a node.
    pub(super) fn has_occluders_below(&self, node: u32) -> bool {
        let end = node + self.nodes[node as usize].skip;
        // They are in the order of nodes.
        let first = self.occluders.partition_point(|(of, ..)| *of < node);
        self.occluders.get(first).is_some_and(|(of, ..)| *of < end)
    }
}
