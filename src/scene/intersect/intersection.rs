//! Intersections, and the interface of intersectors.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::probe::{Candidate, Probe};
use super::surface::Surface;
use crate::scene::features::SurfacePoint;
use crate::scene::id::NodeId;

/// The intersections that an intersector keeps. If images are drawn over each other, the uppermost is the nearest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum IntersectionLimit {
    /// All of them.
    #[default]
    NoLimit,
    /// The nearest intersection of each drawable.
    OnePerDrawable,
    /// Any single intersection, to find out whether there is one.
    One,
    /// The nearest intersection.
    Nearest,
}

impl IntersectionLimit {
    /// Returns true if a candidate cannot change the intersections to keep, of which `first` comes first.
    pub(super) fn is_reached(self, first: Option<&Met>, candidate: &Candidate) -> bool {
        match (self, first) {
            (Self::Nearest, Some(nearest)) => {
                candidate.layer > nearest.candidate.layer
                    || candidate.layer == nearest.candidate.layer && candidate.enters > nearest.ratio
            }
            (Self::One, Some(_)) => true,
            _ => false,
        }
    }
}

/// A primitive that an intersector meets.
#[derive(Clone, Debug)]
pub struct Intersection {
    /// The path from the root page's first node, across the pages between, to the node that holds the drawable.
    pub node_path: Arc<[NodeId]>,
    /// The index of the drawable in the page of the last node.
    pub drawable: u32,
    /// The index of the primitive in the drawable. A mesh counts by its indices; a height tile has two triangles per cell (the
    /// south-eastern one first), cells row by row from the south-west.
    pub primitive: u32,
    /// The corners: indices into a mesh's vertices, or grid points of a height tile row by row from the south-west. The last
    /// one is repeated if there are fewer than three.
    pub vertices: [u32; 3],
    /// The weights of the corners at the point, to interpolate their attributes.
    pub weights: [f64; 3],
    /// The position along the intersector: 0 to 1 of a segment, metres of a ray, the smallest distance from the reference plane
    /// of a polytope. For geometry of another projection it is converted to the position of equal depth in the given view.
    pub ratio: f64,
    /// The largest distance from a polytope's reference plane; equal to `ratio` for lines.
    pub max_ratio: f64,
    /// Maps the drawable's frame to the world.
    pub world_from_local: DAffine3,
    /// The point in the drawable's frame; for a polytope the centre of the part of the primitive that is inside.
    pub local_point: DVec3,
    /// The unit normal of the primitive in the drawable's frame, on the side from which its corners are counter-clockwise;
    /// upwards for height tiles; zero for lines and points.
    pub local_normal: DVec3,
}

impl Intersection {
    /// Returns the point in the world, metres. Below an absolute camera with a separate image it is in the world of that camera.
    pub fn world_point(&self) -> DVec3 {
        self.world_from_local.transform_point3(self.local_point)
    }

    /// Returns the point on the mesh that it meets, for the features there.
    pub fn surface_point(&self) -> SurfacePoint {
        SurfacePoint { vertices: self.vertices, weights: self.weights }
    }

    /// Returns the unit normal in the world; zero for lines and points.
    pub fn world_normal(&self) -> DVec3 {
        (self.world_from_local.matrix3.inverse().transpose() * self.local_normal).normalize_or_zero()
    }

    /// Returns the node that holds the drawable.
    pub fn node(&self) -> Option<NodeId> {
        self.node_path.last().copied()
    }
}

/// An intersection as the intersectors record it.
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

/// The interface of intersectors to the traversal.
pub trait Intersect: Probe {
    /// Clears the results.
    fn clear(&mut self);
    /// Returns true if neither this candidate nor later ones can change the results.
    fn is_done(&self, candidate: &Candidate) -> bool;
    /// Intersects a drawable.
    fn meet(&mut self, candidate: &Candidate, surface: &Surface);
    /// Returns the recorded intersections, and the list for the results.
    fn results(&mut self) -> (&mut Vec<Met>, &mut Vec<Intersection>);
}

/// A shape to intersect the scene with: [`super::LineSegmentIntersector`], [`super::RayIntersector`],
/// [`super::PolytopeIntersector`].
pub trait Intersector: Intersect {}
