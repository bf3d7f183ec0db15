//! The scene's list of pages with OccluderNodes: kept up as pages come and go, read by culls.

use super::page::{Page, Special};
use crate::math::{Aabb, BoundingSphere};

/// A page that has OccluderNodes, and what tells whether it is worth a look.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OccluderPage {
    /// In the scene's page table.
    pub place: u32,
    /// Around its occluders, in its frame; endless where some of them move with the eye.
    pub sphere: BoundingSphere,
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
        Self { place, sphere }
    }
}
