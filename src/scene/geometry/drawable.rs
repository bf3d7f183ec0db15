//! Drawables: a shape with a material, as plain CPU data. Filled by decode workers on any thread, read once by the draw
//! thread when it uploads a page, then dropped unless the application keeps its own `Arc`.

use std::sync::{Arc, Weak};

use super::material::{Material, Texture};
use super::mesh::{Mesh, MeshVertex, SMALL_MESH_INDICES, VertexFormat};
use super::normal_cone::NormalCone;
use super::shape::Geometry;
use crate::math::Aabb;
use crate::scene::sharing::SharedParts;

/// One thing to draw.
#[derive(Clone, Debug)]
pub struct Drawable {
    /// Shape.
    pub geometry: Geometry,
    /// Surface (height tiles carry their own texture; the factor still applies).
    pub material: Material,
    /// Where its faces look, for [`CullingMode::CLUSTER`](super::CullingMode::CLUSTER).
    pub cluster: Option<NormalCone>,
    /// What others have too, if a [`SharedStateManager`](super::SharedStateManager) has looked.
    pub(crate) shared: SharedParts,
    /// What its reader found the vertices of a mesh to be.
    vertex_format: Option<(Weak<Mesh>, VertexFormat)>,
}

impl Drawable {
    /// A shape with a surface.
    pub fn new(geometry: Geometry, material: Material) -> Self {
        Self { geometry, material, cluster: None, shared: SharedParts::default(), vertex_format: None }
    }

    /// The same, of a mesh whose vertices are known to take this format.
    pub(crate) fn with_vertex_format(mut self, format: VertexFormat) -> Self {
        if let Geometry::Mesh(mesh) = &self.geometry {
            self.vertex_format = Some((Arc::downgrade(mesh), format));
        }
        self
    }

    /// How the vertices of a mesh are to lie on the adapter. They are all looked at where no reader has.
    pub(crate) fn vertex_format(&self) -> VertexFormat {
        let Geometry::Mesh(mesh) = &self.geometry else { return VertexFormat::Full };
        if mesh.indices.len() <= SMALL_MESH_INDICES as usize || !mesh.attributes.is_empty() {
            return VertexFormat::Full;
        }
        match &self.vertex_format {
            // The pointer keeps the mesh from being changed in its place, and its address from another mesh.
            Some((known, format)) if std::ptr::eq(known.as_ptr(), Arc::as_ptr(mesh)) => *format,
            _ if mesh.vertices.iter().all(MeshVertex::packs) => VertexFormat::Packed,
            _ => VertexFormat::Full,
        }
    }

    /// The same with the cone of its triangles' normals, unless they look too far apart for one.
    pub fn with_cluster_culling(mut self) -> Self {
        if let (Geometry::Mesh(mesh), false) = (&self.geometry, self.material.double_sided) {
            self.cluster = mesh.normal_cone();
        }
        self
    }

    /// Box around the drawable in its own frame.
    pub fn bounds(&self) -> Aabb {
        self.geometry.bounds()
    }

    /// Bytes of CPU memory the payload holds.
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
