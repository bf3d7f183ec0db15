//! Drawables: a shape with a material, as plain CPU data. Filled by decode workers on any thread, read once by the draw
//! thread when it uploads a page, then dropped unless the application keeps its own `Arc`.

use std::collections::HashSet;
use std::sync::{Arc, Weak};

use super::material::Material;
use super::mesh::{Mesh, MeshVertex, SMALL_MESH_INDICES, VertexFormat};
use super::normal_cone::NormalCone;
use super::shape::Geometry;
use super::texture::{BlockFormats, Texture};
use crate::math::Aabb;
use crate::scene::features::DrawableFeatures;
use crate::scene::nodes::CullCallback;
use crate::scene::sharing::SharedParts;
use crate::state::StateSet;

/// A shape with a surface, which is drawn by one draw call or a part of one.
#[derive(Clone, Debug)]
pub struct Drawable {
    /// The shape.
    pub geometry: Geometry,
    /// The surface. Height tiles carry their own texture; the colour factor still applies.
    pub material: Material,
    /// State for the drawable alone, below that of its node; shared by identity. The page takes it.
    pub state_set: Option<Arc<StateSet>>,
    /// Called by cull before it tests the drawable. The page takes it.
    pub cull_callback: Option<CullCallback>,
    /// The cone of its normals, for [`CullingMode::CLUSTER`](crate::scene::CullingMode::CLUSTER).
    pub cluster: Option<NormalCone>,
    /// The features that the drawable shows, which stay with the page; usually none.
    pub features: Option<Arc<DrawableFeatures>>,
    /// Contents shared with other drawables, set by a [`SharedStateManager`](crate::scene::SharedStateManager).
    pub(crate) shared: SharedParts,
    /// The vertex format that the reader found for a mesh.
    vertex_format: Option<(Weak<Mesh>, VertexFormat)>,
}

impl Drawable {
    /// Creates a drawable.
    pub fn new(geometry: Geometry, material: Material) -> Self {
        Self {
            geometry,
            material,
            state_set: None,
            cull_callback: None,
            cluster: None,
            features: None,
            shared: SharedParts::default(),
            vertex_format: None,
        }
    }

    /// Sets the state set.
    pub fn with_state_set(mut self, state_set: Arc<StateSet>) -> Self {
        self.state_set = Some(state_set);
        self
    }

    /// Stores the vertex format that a reader found for the mesh.
    pub(crate) fn with_vertex_format(mut self, format: VertexFormat) -> Self {
        self.set_vertex_format(format);
        self
    }

    /// Stores the vertex format of the mesh, so that the thread that uploads need not look at all vertices.
    pub(crate) fn set_vertex_format(&mut self, format: VertexFormat) {
        if let Geometry::Mesh(mesh) = &self.geometry {
            self.vertex_format = Some((Arc::downgrade(mesh), format));
        }
    }

    /// Returns true if the vertex format of the mesh is stored.
    #[cfg(test)]
    pub(crate) fn has_vertex_format(&self) -> bool {
        self.vertex_format.is_some()
    }

    /// Returns the vertex format for the upload of a mesh. Checks all vertices if no reader has done so.
    pub(crate) fn vertex_format(&self) -> VertexFormat {
        let Geometry::Mesh(mesh) = &self.geometry else { return VertexFormat::Full };
        if mesh.indices.len() <= SMALL_MESH_INDICES as usize || !mesh.attributes.is_empty() {
            return VertexFormat::Full;
        }
        match &self.vertex_format {
            // The weak pointer prevents that the mesh is modified directly, or that another one gets its address.
            Some((known, format)) if std::ptr::eq(known.as_ptr(), Arc::as_ptr(mesh)) => *format,
            _ if mesh.vertices.iter().all(MeshVertex::packs) => VertexFormat::Packed,
            _ => VertexFormat::Full,
        }
    }

    /// Adds the cone of its triangles' normals, unless the normals diverge too far or the material is double-sided.
    pub fn with_cluster_culling(mut self) -> Self {
        if let (Geometry::Mesh(mesh), false) = (&self.geometry, self.material.double_sided) {
            self.cluster = mesh.normal_cone();
        }
        self
    }

    /// Returns the box around the drawable in its own frame.
    pub fn bounds(&self) -> Aabb {
        self.geometry.bounds()
    }

    /// Returns the families of compressed formats that its textures need.
    pub(crate) fn block_formats(&self) -> BlockFormats {
        let of_height = match &self.geometry {
            Geometry::Height(tile) => tile.texture.as_ref(),
            _ => None,
        };
        let formats = self.material.textures().chain(of_height).map(|texture| BlockFormats::of(texture.format));
        formats.fold(BlockFormats::NONE, BlockFormats::union)
    }

    /// Returns the bytes of CPU memory that the payload holds.
    pub fn size_bytes(&self) -> u64 {
        self.size_bytes_beside(&mut HashSet::new())
    }

    /// Returns the bytes of CPU memory that the payload holds beside shapes and images whose addresses are in `counted`. Adds
    /// those that other drawables may share.
    pub(crate) fn size_bytes_beside(&self, counted: &mut HashSet<usize>) -> u64 {
        fn is_new<T>(shared: &Arc<T>, counted: &mut HashSet<usize>) -> bool {
            Arc::strong_count(shared) == 1 || counted.insert(Arc::as_ptr(shared).addr())
        }
        let mut texture_bytes = |t: &Arc<Texture>| -> u64 { if is_new(t, counted) { t.size_bytes() } else { 0 } };
        let material: u64 = self.material.textures().map(&mut texture_bytes).sum();
        let of_height = match &self.geometry {
            Geometry::Height(t) => t.texture.as_ref().map_or(0, &mut texture_bytes),
            _ => 0,
        };
        let shape = match &self.geometry {
            Geometry::Mesh(m) if is_new(m, counted) => {
                (m.vertices.len() * size_of::<MeshVertex>() + m.indices.len() * 4) as u64 + m.attributes.size_bytes()
            }
            Geometry::Mesh(_) => 0,
            Geometry::Height(t) => (t.heights.len() * 4 + t.rows.len() * 16 + t.columns.len() * 8) as u64,
            Geometry::Splats(splats) if is_new(splats, counted) => splats.size_bytes(),
            Geometry::Splats(_) => 0,
            Geometry::Custom(custom) => custom.size_bytes,
        };
        shape + of_height + material
    }
}
