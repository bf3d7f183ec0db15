//! Bounding spheres of the nodes of a page, and the list of those that must be fitted again.

use glam::{DVec3, Vec4};

use super::stored_bounds::UNBOUNDED;
use crate::math::BoundingSphere;

/// Spheres relative to an origin, with an entry for each node.
#[derive(Debug, Default)]
pub(crate) struct NodeSpheres {
    /// Centre relative to `origin`, and radius; a negative radius if nothing is below.
    spheres: Vec<Vec4>,
    /// The point of the page's frame that bounds are relative to.
    origin: DVec3,
    /// Nodes marked as stale, in no order.
    stale: Vec<u32>,
    /// The number of spheres fitted so far.
    fitted: u64,
}

impl NodeSpheres {
    pub(super) fn new(node_count: usize, origin: DVec3) -> Self {
        Self { spheres: vec![Vec4::ZERO; node_count], origin, stale: Vec::new(), fitted: 0 }
    }

    /// Returns the sphere of each node: centre relative to the origin, and radius.
    #[inline(always)]
    pub fn spheres(&self) -> &[Vec4] {
        &self.spheres
    }

    /// Returns the point of the page's frame that all bounds of the page are relative to.
    #[inline(always)]
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Stores the sphere of a node without counting it as fitted.
    pub(super) fn set(&mut self, node: usize, sphere: Vec4) {
        self.spheres[node] = sphere;
    }

    /// Counts spheres that were fitted.
    pub(super) fn count_fitted(&mut self, spheres: u64) {
        self.fitted += spheres;
    }

    /// Returns the number of spheres fitted so far.
    pub fn fitted(&self) -> u64 {
        self.fitted
    }

    /// Lists a node whose sphere must be fitted again.
    pub(super) fn push_stale(&mut self, node: u32) {
        self.stale.push(node);
    }

    /// Returns the nodes whose spheres must be fitted again, in no order.
    pub fn stale(&self) -> &[u32] {
        &self.stale
    }

    /// Takes the list of stale nodes; [`Self::reuse_stale`] returns its memory.
    pub(super) fn take_stale(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.stale)
    }

    /// Keeps the memory of an emptied list for the next changes.
    pub(super) fn reuse_stale(&mut self, mut list: Vec<u32>) {
        list.clear();
        self.stale = list;
    }

    /// Converts a stored sphere to the page's frame; `None` if it is empty or unbounded.
    pub(super) fn in_page(&self, stored: Vec4) -> Option<BoundingSphere> {
        let is_bound = stored.w >= 0.0 && stored.w < UNBOUNDED;
        is_bound.then(|| BoundingSphere::new(self.origin + stored.truncate().as_dvec3(), f64::from(stored.w)))
    }
}
