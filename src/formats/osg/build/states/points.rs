//! Draws points of more than one pixel as squares. Decode threads.

use std::sync::Arc;

use crate::fetch::{IoError, about_to_allocate};
use crate::formats::osg::build::Builder;
use crate::formats::subset::Subset;
use crate::scene::{Mesh, MeshVertex, Topology};

/// The largest side of a point, which drivers of OpenGL limit as well.
const MAX_SIZE_PX: f32 = 255.0;

impl Builder<'_> {
    /// Makes squares of the points among meshes, whose second value stays.
    pub(in super::super) fn enlarge_points(
        &mut self,
        meshes: &mut [(Arc<Mesh>, bool)],
        size_px: f32,
        has_texture: bool,
    ) -> Result<(), IoError> {
        /// The vertices of a square, and its indices.
        const CORNERS: usize = 4;
        const INDICES: usize = 6;
        for (mesh, _) in meshes.iter_mut().filter(|(mesh, _)| mesh.topology == Topology::Points) {
            if has_texture || mesh.indices.len().saturating_mul(INDICES) > self.source.options.limits.max_elements {
                self.note("OpenSceneGraph: size of points that have a texture or are too many");
                continue;
            }
            let bytes = CORNERS * size_of::<MeshVertex>() + 2 * INDICES * size_of::<u32>();
            let all = (bytes * mesh.indices.len()) as u64;
            about_to_allocate(all).map_err(|error| error.at(self.source.uri))?;
            let side = size_px.min(MAX_SIZE_PX);
            let squares = Subset::squares(mesh, &mesh.indices)
                .mesh(|_, vertex| vertex.uv = vertex.uv.map(|direction| 0.5 * side * direction));
            *mesh = Arc::new(squares);
        }
        Ok(())
    }
}
