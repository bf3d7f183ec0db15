//! What is drawn: meshes, height tiles, textures and materials, as plain CPU data.
//!
//! Filled by decode workers, read once by the draw thread when it compiles a page, then dropped
//! unless the application keeps its own `Arc`.

use std::sync::{Arc, Weak};

use super::draw_kinds::SMALL_MESH_INDICES;
use super::kinds::NormalCone;
use super::shared::SharedParts;
use super::vertex_attributes::VertexAttributes;
use crate::math::Aabb;
use crate::state::{DrawHook, WrapMode};

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

    /// The directions in which the triangles look; `None` without triangles, or where they look apart by 90 degrees
    /// or more from their mean.
    pub fn normal_cone(&self) -> Option<NormalCone> {
        if self.topology != Topology::Triangles {
            return None;
        }
        let corner = |i: u32| self.vertices.get(i as usize).map(|v| glam::DVec3::from_array(v.position.map(f64::from)));
        let faces = || {
            self.indices.chunks_exact(3).filter_map(|t| {
                let (a, b, c) = (corner(t[0])?, corner(t[1])?, corner(t[2])?);
                Some(([a, b, c], (b - a).cross(c - a)))
            })
        };
        let mean = faces().fold(glam::DVec3::ZERO, |sum, (_, n)| sum + n).try_normalize()?;
        let unit = || faces().filter_map(|(corners, n)| Some((corners, n.try_normalize()?)));
        let widest = unit().map(|(_, n)| n.dot(mean)).fold(1.0, f64::min);
        if widest <= 1e-3 {
            return None;
        }
        let control_point = self.bounds.center();
        let distance = |p: glam::DVec3| p.distance(control_point);
        let radius_m = unit().flat_map(|(corners, _)| corners).map(distance).fold(0.0, f64::max);
        // A face looks away from directions more than 90 degrees from its normal; seen from outside of `radius`, a
        // corner's direction to the eye differs from the middle's by less than that of a sphere twice as far.
        let half_angle = widest.min(1.0).acos();
        let from_middle = 0.5f64.asin();
        Some(NormalCone {
            control_point,
            normal: mean,
            least_cosine: (std::f64::consts::FRAC_PI_2 + half_angle + from_middle).min(std::f64::consts::PI).cos(),
            radius_m: 2.0 * radius_m,
        })
    }
}

/// An RGBA8 sRGB image with its mip levels, level 0 first, each half the size of the one before (at least 1).
#[derive(Clone, PartialEq)]
pub struct Texture {
    /// Width of level 0 in texels.
    pub width: u32,
    /// Height of level 0 in texels.
    pub height: u32,
    /// Rows top to bottom, 4 bytes a texel; one entry per level.
    pub mips: Vec<Vec<u8>>,
    /// What is outside 0..1 along u and along v.
    pub wrap: [WrapMode; 2],
}

impl std::fmt::Debug for Texture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Texture({}x{}, {} mips)", self.width, self.height, self.mips.len())
    }
}

/// How alpha is used; glTF's `alphaMode`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Fragments below the cutoff are dropped.
    Mask(f32),
    /// Blended over what is behind; goes to the depth-sorted transparent bin.
    Blend,
}

/// Surface of a mesh; the part of glTF's material that is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Linear RGBA factor.
    pub base_color: [f32; 4],
    /// Multiplied with the factor when present.
    pub texture: Option<Arc<Texture>>,
    /// Use of alpha.
    pub alpha: AlphaMode,
    /// Draw back faces too.
    pub double_sided: bool,
    /// Not lit by the sun (KHR_materials_unlit).
    pub unlit: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self { base_color: [1.0; 4], texture: None, alpha: AlphaMode::Opaque, double_sided: false, unlit: false }
    }
}

/// A square of heights, drawn from one shared grid by the vertex shader.
///
/// Frame: origin at the tile's centre on the ellipsoid (or plane), axes east, "radial", "polar"; the page's
/// transform rotates that frame into the world. Vertex (i, j), i east, j north, with height h lies at
/// ```text
/// east   = (p0 + row.dp + h * row.cos) * col.sin
/// radial =  row.dp + h * row.cos - (p0 + row.dp + h * row.cos) * col.one_minus_cos
/// polar  =  row.dz + h * row.sin
/// ```
/// which is the exact ellipsoid in small differences (p: distance from the earth's axis, z: along it). A plane is the
/// same at the pole of an endless earth: `p0` vast, `row = [-north, 0, 0, 1]`, `col = [east / p0, 0]`.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightTile {
    /// Vertices along a side, 2^k + 1 (65).
    pub side: u32,
    /// `(side + 2)^2` heights in metres above the ellipsoid or plane, one border sample around, row-major,
    /// **south-west first**, east fastest.
    pub heights: Vec<f32>,
    /// Per row, south to north, `side` entries: `[dp, dz, cos, sin]`.
    pub rows: Vec<[f32; 4]>,
    /// Per column, west to east, `side` entries: `[sin, one_minus_cos]`.
    pub columns: Vec<[f32; 2]>,
    /// Distance of the origin from the earth's axis, metres.
    pub p0_m: f32,
    /// Level of the tile, root 0.
    pub level: u32,
    /// Geometric errors in metres of the levels `level-1, level-2, ...` (as many as exist, at most 6): where
    /// a vertex morphs into the coarser grid depends on the level and the distance only, so that neighbours agree.
    pub coarser_errors_m: Vec<f32>,
    /// Depth of the skirt in metres.
    pub skirt_m: f32,
    /// Size of a cell at the tile's centre, metres east and north (for normals).
    pub cell_m: [f32; 2],
    /// Colour, north up (row 0 is the northern edge); white when absent.
    pub texture: Option<Arc<Texture>>,
    /// Box around the tile in its frame, skirt included.
    pub bounds: Aabb,
}

/// What the application draws itself, made by `draw::custom_geometry`. It is culled, sorted and faded like any
/// other, casts no shadow and is not met by intersections.
#[derive(Clone, Debug)]
pub struct CustomGeometry {
    /// Box around it in its own frame; what lies outside may be culled.
    pub bounds: Aabb,
    /// CPU memory that it holds.
    pub size_bytes: u64,
    /// Made by and given back to `draw`.
    pub hook: DrawHook,
}

/// Geometry of a [`Drawable`].
#[derive(Clone, Debug)]
pub enum Geometry {
    /// Indexed primitives.
    Mesh(Arc<Mesh>),
    /// Heights on the shared grid.
    Height(Arc<HeightTile>),
    /// Drawn by the application.
    Custom(CustomGeometry),
}

impl Geometry {
    /// Box around it in its own frame.
    pub fn bounds(&self) -> Aabb {
        match self {
            Self::Mesh(mesh) => mesh.bounds,
            Self::Height(tile) => tile.bounds,
            Self::Custom(custom) => custom.bounds,
        }
    }
}

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
