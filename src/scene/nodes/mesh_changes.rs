//! Meshes that change: replacing a mesh while draw may still read the old one. Update thread.

use std::sync::Arc;

use crate::scene::error::SceneError;
use crate::scene::geometry::Mesh;
use crate::scene::graph::Scene;
use crate::scene::id::NodeId;
use crate::scene::rewritten_mesh::RewrittenMesh;
use crate::state::DataVariance;

impl Scene {
    /// Replaces a mesh of a Geode from this frame on and fits the bounds to it. `drawable` is an index into the Geode's
    /// drawables. Material and state stay; a normal cone is dropped.
    ///
    /// With [`DataVariance::Static`] the next update may begin while draw still reads the mesh: an application that
    /// writes it with `Arc::make_mut` then writes a copy. With [`DataVariance::Dynamic`] the frame waits until draw has
    /// released it, and `Arc::make_mut` writes without a copy.
    ///
    /// A k-d tree of the drawable is rebuilt at once, about 300 ns a triangle: scenes that rewrite large meshes every
    /// frame should do without trees.
    pub fn set_mesh(
        &mut self,
        node: NodeId,
        drawable: usize,
        mesh: Arc<Mesh>,
        variance: DataVariance,
    ) -> Result<(), SceneError> {
        let page = self.page_of_node(node)?;
        let number =
            page.set_mesh_bounds(node.index, drawable, &mesh).ok_or(SceneError::NotAMesh { node, drawable })?;
        page.replace_mesh(number, &mesh);
        let rewritten = RewrittenMesh { page: node.page, drawable: number, mesh, variance };
        // The last change of an update counts.
        let list = self.rewritten_mut();
        match list.iter_mut().find(|r| (r.page, r.drawable) == (node.page, number)) {
            Some(earlier) => *earlier = rewritten,
            None => list.push(rewritten),
        }
        self.note_stale(node.page);
        Ok(())
    }
}
