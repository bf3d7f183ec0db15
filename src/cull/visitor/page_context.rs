//! Values that stay constant while the nodes of one page are scanned. Culling thread.

use glam::{DAffine3, DVec3, Vec4};

use super::page_queue::PageVisit;
use crate::cull::views::Planes;
use crate::scene::{CullInfo, DrawSlot, Page, UNBOUNDED};

/// A page under scan, seen from the eye of the current view.
#[derive(Clone, Copy)]
pub(in crate::cull) struct PageContext<'a> {
    pub page: &'a Page,
    pub visit: PageVisit,
    /// Linear part of `eye_from_page` as rows.
    pub eye_rows: [DVec3; 3],
    /// Position of the eye in the page's frame; computed only where the page needs it, otherwise 0.
    pub eye: DVec3,
    /// Frustum planes, relative to the page's origin.
    pub planes: Planes,
    /// Row that gives the depth of a point relative to the page's origin.
    pub depth: Vec4,
    /// Draw slots of the page's drawables in the context that is culled for.
    pub slots: &'a [DrawSlot],
    /// Drawables need more than the test of their boxes: callbacks, normal cones, occluders or primitives.
    pub looks_closer: bool,
    /// Some drawables are culled by their normal cones.
    pub has_clusters: bool,
    /// Near and far follow the primitives of drawables and not their boxes.
    pub by_primitives: bool,
}

/// The innermost subtree with its own planes or matrix while nodes are scanned; the values above it are on the stack.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct OpenNode {
    /// One past the last node of the subtree.
    pub end: u32,
    /// Index in the stage of the matrix that holds in the subtree.
    pub matrix: u32,
    /// Planes that nodes of the subtree may cross, in the lowest bits.
    pub mask: u32,
}

/// Returns the argument for the cull callback of a node.
pub(in crate::cull) fn cull_info(page: &Page, node: u32, eye_in_page: DVec3, frame: u32) -> CullInfo {
    let sphere = page.spheres()[node as usize];
    let center = page.origin() + sphere.truncate().as_dvec3();
    let is_bounded = (0.0..UNBOUNDED).contains(&sphere.w);
    CullInfo { frame, eye_in_page, distance_m: if is_bounded { center.distance(eye_in_page) } else { f64::INFINITY } }
}

/// Returns the argument for the cull callback of a drawable whose box has a centre, relative to the page's origin.
pub(super) fn drawable_info(context: &PageContext, center: [f32; 3], is_bounded: bool, frame: u32) -> CullInfo {
    let center = context.page.origin() + DVec3::from_array(center.map(f64::from));
    let eye_in_page = context.eye;
    CullInfo { frame, eye_in_page, distance_m: if is_bounded { center.distance(eye_in_page) } else { f64::INFINITY } }
}

/// Returns the position of the eye in the frame of `eye_from_frame`; 0 where the map has no inverse.
pub(in crate::cull) fn eye_in(eye_from_frame: &DAffine3) -> DVec3 {
    let eye = eye_from_frame.inverse().translation;
    if eye.is_finite() { eye } else { DVec3::ZERO }
}
