//! Drawables: a shape with a material, as plain CPU data. Filled by decode workers on any thread, read once by the draw
//! thread when it uploads a page, then dropped unless the application keeps its own `Arc`.

use std::sync::{Arc, Weak};

use super::material::{Material, Texture};
use super::mesh::{Mesh, MeshVertex, SMALL_MESH_INDICES, VertexFormat};
use super::normal_cone::NormalCone;
use super::shape::Geometry;
use crate::math::Aabb;
use crate::scene::sharing::SharedParts;

/// A shape with a surface, which is drawn by one draw call or a part of one.
#[derive(Clone, Debug)]
pub struct Drawable {
    /// The shape.
    pub geometry: Geometry,
    /// The surface. Height tiles carry their own texture; the colour factor still applies.
    pub material: Material,
    /// The cone of its normals, for [`CullingMode::CLUSTER`](crate::scene::CullingMode::CLUSTER).
    pub cluster: Option<NormalCone>,
    /// Contents shared with other drawables, set by a [`SharedStateManager`](crate::scene::SharedStateManager).
    pub(crate) shared: SharedParts,
    /// The vertex format that the reader found for a mesh.
    vertex_format: Option<(Weak<Mesh>, VertexFormat)>,
}

impl Drawable {
    /// Creates a drawable.
    pub fn new(geometry: Geometry, material: Material) -> Self {
        Self { geometry, material, cluster: None, shared: SharedParts::default(), vertex_format: None }
    }

    /// Stores the vertex format that a reader found for the mesh.
    pub(crate) fn with_vertex_format(mut self, format: VertexFormat) -> Self {
        if let Geometry::Mesh(mesh) = &self.geometry {
            self.vertex_format = Some((Arc::downgrade(mesh), format));
        }
        self
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

    /// Returns the bytes of CPU memory that the payload holds.
    pub fn size_bytes(&self) -> u64 {
        let texture_bytes =
            |t: &Option<Arc<Texture>>| -> u64 { t.iter().flat_map(|t| t.mips.iter()).map(|m| m.len() as u64).sum() };
        let shape = match &self.geometry {
            Geometry::Mesh(m) => {
                (m.vertices.len() * size_of::<MeshVertex>() + m.indices.len() * 4) as u64 + m.attributes.size_bytes()
            }
            Geometry::Height(t) => {
                (t.heights.len() * 4 + t.rows.len() * 16 + t.columns.len() * 8) as u64 + texture_bytes(&t.texture)
            }
            Geometry::Custom(custom) => custom.size_bytes,
        };
        shape + texture_bytes(&self.material.texture)
    }
}
