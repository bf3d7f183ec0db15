//! What an intersector keeps and returns. Plain values.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::probe::{Candidate, Probe};
use super::surface::Surface;
use crate::scene::id::NodeId;

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
