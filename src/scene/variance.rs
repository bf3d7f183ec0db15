//! Meshes that change: what happens to data that update changes while draw may still read it.

use std::sync::Arc;

use super::error::SceneError;
use super::geometry::{Geometry, Mesh};
use super::intersect::KdTree;
use super::page::kind;
use super::{NodeId, Page, PageId, Scene};
use crate::state::DataVariance;

/// A mesh that takes the place of a drawable's, until it was sent to the contexts.
#[derive(Clone, Debug)]
pub(crate) struct Rewritten {
    pub(crate) page: PageId,
    /// Number of the drawable in its page.
    pub(crate) drawable: u32,
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) variance: DataVariance,
}

impl Scene {
    /// Puts another mesh in the place of a Geode's, from the frame on whose update this is part of, and fits bounds to
    /// it. `drawable` counts those of the node. Material and state stay; a normal cone is forgotten.
    ///
    /// With [`DataVariance::Static`] the next update may come while draw still reads the mesh: an application that
    /// writes it with `Arc::make_mut` then writes a copy. With [`DataVariance::Dynamic`] the frame waits until draw has
    /// let go of it, and `Arc::make_mut` writes in place.
    ///
    /// A k-d tree of the drawable is built anew at once, some 300 ns a triangle: scenes that rewrite large meshes every
    /// frame do better without trees.
    pub fn set_mesh(
        &mut self,
        node: NodeId,
        drawable: usize,
        mesh: Arc<Mesh>,
        variance: DataVariance,
    ) -> Result<(), SceneError> {
        let page = self.page_mut(node.page).ok_or(SceneError::StaleNode { node })?;
        if node.index as usize >= page.node_count() {
            return Err(SceneError::StaleNode { node });
        }
        let number =
            page.set_mesh_bounds(node.index, drawable, &mesh).ok_or(SceneError::NotAMesh { node, drawable })?;
        page.replace_geometry(number, &mesh);
        let rewritten = Rewritten { page: node.page, drawable: number, mesh, variance };
        // The last word of an update counts.
        match self.rewritten.iter_mut().find(|r| (r.page, r.drawable) == (node.page, number)) {
            Some(earlier) => *earlier = rewritten,
            None => self.rewritten.push(rewritten),
        }
        self.note_stale(node.page);
        Ok(())
    }

    /// The meshes that the contexts have not been told of.
    pub(crate) fn rewritten_mut(&mut self) -> &mut Vec<Rewritten> {
        &mut self.rewritten
    }
}

impl Page {
    /// What intersections meet.
    fn replace_geometry(&mut self, drawable: u32, mesh: &Arc<Mesh>) {
        let geometry = Geometry::Mesh(mesh.clone());
        if let Some(tree) = self.kd_trees.get_mut(drawable as usize) {
            *tree = KdTree::build(&geometry).map(Arc::new);
        }
        if let Some(kept) = self.drawables.get_mut(drawable as usize) {
            kept.geometry = geometry;
        }
    }

    /// Fits bounds to the new mesh of a Geode's drawable; the drawable's number in the page.
    fn set_mesh_bounds(&mut self, node: u32, drawable: usize, mesh: &Mesh) -> Option<u32> {
        let index = node as usize;
        let record = *self.nodes.get(index).filter(|n| n.kind == kind::GEODE)?;
        // Its own drawables come before those of the nodes below it, and a Geode has none.
        let end = self.nodes.get(index + 1)?.first_drawable;
        let number = record.first_drawable.checked_add(u32::try_from(drawable).ok()?).filter(|n| *n < end)?;
        self.local_boxes[number as usize] = mesh.bounds;
        self.clusters.retain(|(of, _)| *of != number);
        self.fit_boxes(number as usize, number as usize + 1);
        let before = self.spheres[index];
        self.fit_spheres(index, index + 1);
        if self.spheres[index] != before {
            self.outdate_above(node);
        }
        Some(number)
    }
}
