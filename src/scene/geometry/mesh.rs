//! Meshes: indexed primitives as plain CPU data. Filled by decode workers on any thread, read once by the draw thread
//! when it uploads a page.

use std::sync::Arc;

use super::attribute_format::AttributeFormat;
use super::vertex_attributes::VertexAttributes;
use crate::math::Aabb;
use crate::scene::error::MeshError;

/// Meshes with at most this number of indices are drawn many by one call.
pub(crate) const SMALL_MESH_INDICES: u32 = 48;

/// A vertex of a [`Mesh`], as the GPU reads it (28 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MeshVertex {
    /// Metres in the drawable's frame (near its origin, so that `f32` is enough).
    pub position: [f32; 3],
    /// Texture coordinates, origin at the image's upper left.
    pub uv: [f32; 2],
    /// Unit normal as snorm8; w is unused. If it is zero, the shader uses the facet's normal.
    pub normal: [i8; 4],
    /// Linear colour factor as unorm8.
    pub color: [u8; 4],
}

impl MeshVertex {
    /// Half a step of unorm16, the rounding error of packed texture coordinates.
    const UV_SLACK: f32 = 0.5 / 65535.0;

    /// Returns true if [`VertexFormat::Packed`] can hold the vertex.
    pub(crate) fn packs(&self) -> bool {
        let is_within = |x: f32| (-Self::UV_SLACK..=1.0 + Self::UV_SLACK).contains(&x);
        self.color == [255; 4] && is_within(self.uv[0]) && is_within(self.uv[1])
    }
}

/// The layout of a mesh's vertices in GPU memory. The smallest one without visible loss is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum VertexFormat {
    /// The layout of a [`MeshVertex`], 28 bytes. Small meshes and meshes with custom attributes always use it.
    #[default]
    Full,
    /// White, with texture coordinates of 0 to 1; 20 bytes.
    Packed,
    /// `Packed`, with positions that were read as 16-bit values of 0 to 1; 16 bytes.
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
    /// One index a point, which is drawn as one pixel.
    Points,
    /// Six indices a point: two triangles of four vertices at one position. Texture coordinates are the offsets of the
    /// vertices from it in pixels, to the right and up. They are drawn like points of that size, with the texel at the
    /// origin of the drawable's texture. A [`Program`](crate::state::Program) must move the vertices itself.
    Squares,
}

/// Indexed geometry in a separate frame.
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
    /// Custom attributes of the vertices, for programs; usually none.
    pub attributes: VertexAttributes,
}

impl Default for Mesh {
    /// Returns a mesh without vertices.
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
    /// Returns true if the mesh has so few triangles that many such meshes are drawn by one call. Meshes with custom
    /// attributes are not.
    pub(crate) fn is_small(&self) -> bool {
        let is_short = (3..=SMALL_MESH_INDICES as usize).contains(&self.indices.len());
        is_short && self.topology == Topology::Triangles && self.attributes.is_empty()
    }

    /// Adds a custom attribute with one element per vertex, whose bytes are those of `values`.
    /// [`Program`](crate::state::Program)s read it by its name; built-in shading ignores it. The name must differ from the
    /// fields of [`MeshVertex`]. If vertices are added later, the upload of the mesh fails.
    ///
    /// Meshes with custom attributes are uploaded with [`VertexFormat::Full`], and small ones are not drawn many by one
    /// call. At most fifteen different lists of names and formats can be resident at once.
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
