//! Meshes: indexed primitives as plain CPU data. Filled by decode workers on any thread, read once by the draw thread
//! when it uploads a page.

use std::sync::Arc;

use super::attribute_format::AttributeFormat;
use super::vertex_attributes::VertexAttributes;
use crate::math::Aabb;
use crate::scene::error::MeshError;

/// Meshes with at most this number of indices are drawn many by one call.
pub(crate) const SMALL_MESH_INDICES: u32 = 48;

/// One vertex of a [`Mesh`], as the GPU reads it (28 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MeshVertex {
    /// Metres in the drawable's frame (near its origin, so that `f32` is enough).
    pub position: [f32; 3],
    /// Texture coordinates, origin at the image's upper left.
    pub uv: [f32; 2],
    /// Unit normal as snorm8; w unused. Zero means none: the shader then uses the facet's normal.
    pub normal: [i8; 4],
    /// Linear colour factor as unorm8.
    pub color: [u8; 4],
}

impl MeshVertex {
    /// Half a step of unorm16.
    const UV_SLACK: f32 = 0.5 / 65535.0;

    pub(crate) fn packs(&self) -> bool {
        let is_within = |x: f32| (-Self::UV_SLACK..=1.0 + Self::UV_SLACK).contains(&x);
        self.color == [255; 4] && is_within(self.uv[0]) && is_within(self.uv[1])
    }
}

/// How the vertices of a mesh lie on the adapter: in as few bytes as lose nothing visible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum VertexFormat {
    /// As a [`MeshVertex`]. Small meshes, and those with further attributes, always do.
    #[default]
    Full,
    /// White, with texture coordinates of 0 to 1: 20 bytes.
    Packed,
    /// `Packed`, with positions that were read from 16 bits each, of 0 to 1: 16 bytes.
    Quantized,
}

/// How indices form primitives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Topology {
    /// Three indices a triangle, counter-clockwise front.
    #[default]
    Triangles,
    /// Two indices a segment.
    Lines,
    /// One index a point.
    Points,
}

/// Indexed geometry in a frame of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Vertices.
    pub vertices: Vec<MeshVertex>,
    /// Indices into `vertices`; each below `vertices.len()`. Shared when many tiles have the same grid.
    pub indices: Arc<[u32]>,
    /// How the indices form primitives.
    pub topology: Topology,
    /// Box around the positions.
    pub bounds: Aabb,
    /// What vertices have beside a [`MeshVertex`], for programs; mostly nothing.
    pub attributes: VertexAttributes,
}

impl Default for Mesh {
    /// Nothing at all.
    fn default() -> Self {
        Self {
            vertices: Vec::new(),
            indices: Arc::default(),
            topology: Topology::Triangles,
            bounds: Aabb::EMPTY,
            attributes: VertexAttributes::default(),
        }
    }
}

impl Mesh {
    /// Of so few triangles that shaders fetch the vertices of many such meshes in one call; with further attributes they
    /// do not.
    pub(crate) fn is_small(&self) -> bool {
        let is_short = (3..=SMALL_MESH_INDICES as usize).contains(&self.indices.len());
        is_short && self.topology == Topology::Triangles && self.attributes.is_empty()
    }

    /// The same with a further attribute of its vertices, one element for each: `values` are taken as the bytes that they
    /// are. [`Program`](crate::state::Program)s read it under its name, other shading takes no notice. Not a name that a
    /// [`MeshVertex`](super::MeshVertex) has. Where vertices are added later the mesh fails to upload.
    ///
    /// Meshes with further attributes lie on the adapter as they come and are not drawn many by one call where they are
    /// small. Those of fifteen different lists of names and formats may be uploaded at once.
    pub fn with_attribute<T: bytemuck::NoUninit>(
        mut self,
        name: &str,
        format: AttributeFormat,
        values: &[T],
    ) -> Result<Self, MeshError> {
        self.attributes.push(self.vertices.len(), name, format, bytemuck::cast_slice(values).into())?;
        Ok(self)
    }
}
