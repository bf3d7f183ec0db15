//! The order of vertices and triangles for the GPU's caches.

use meshoptimizer_rs::{Workspace, optimize_vertex_cache};

use super::GlbMesh;

/// Returns the triangles in the order for the GPU's cache of transformed vertices, with their vertices numbered by first use, and
/// the old number of each vertex that is used. Returns `None` for incomplete triangles or invalid indices.
pub(super) fn cache_order(indices: &[u32], vertices: usize) -> Option<(Vec<u32>, Vec<usize>)> {
    let ordered = optimize_vertex_cache(indices, vertices, &mut Workspace::default()).ok()?;
    let mut old_of_new: Vec<usize> = Vec::with_capacity(vertices);
    let mut new_of_old: Vec<Option<u32>> = vec![None; vertices];
    let renumbered = ordered.into_iter().map(|old| {
        *new_of_old[old as usize].get_or_insert_with(|| {
            old_of_new.push(old as usize);
            (old_of_new.len() - 1) as u32
        })
    });
    let renumbered = renumbered.collect();
    Some((renumbered, old_of_new))
}

impl GlbMesh {
    /// Orders the triangles for the GPU's cache of transformed vertices, and the vertices by their first use, so that they are
    /// fetched in order. Vertices that no triangle uses are removed. A mesh with incomplete triangles, invalid indices or
    /// attributes of unequal length stays as it is.
    pub fn optimize_order(&mut self) {
        let count = self.positions.len();
        let tangents = self.normal_map.as_ref().map_or(0, |map| map.tangents.len());
        if [self.normals.len(), self.uvs.len(), tangents].iter().any(|length| *length != 0 && *length != count) {
            return;
        }
        let indices: Vec<u32> = self.indices.iter().copied().map(u32::from).collect();
        let Some((indices, old_of_new)) = cache_order(&indices, count) else { return };
        self.indices = indices.into_iter().map(|index| index as u16).collect();
        self.positions = old_of_new.iter().map(|old| self.positions[*old]).collect();
        if !self.normals.is_empty() {
            self.normals = old_of_new.iter().map(|old| self.normals[*old]).collect();
        }
        if !self.uvs.is_empty() {
            self.uvs = old_of_new.iter().map(|old| self.uvs[*old]).collect();
        }
        if let Some(map) = self.normal_map.as_mut().filter(|map| !map.tangents.is_empty()) {
            map.tangents = old_of_new.iter().map(|old| map.tangents[*old]).collect();
        }
    }
}
