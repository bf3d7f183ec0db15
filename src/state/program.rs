//! Programs and uniforms: shading of the application's own.

use std::sync::Arc;

/// WGSL that replaces the shading of meshes and height tiles.
///
/// It stands behind what `src/draw/shaders/frame.wgsl` and `mesh_vertex.wgsl` declare: `frame`, `leaves`,
/// `MeshVertex`, `point_in_eye`. It has a vertex entry point `vs_main(vertex: MeshVertex, @builtin(instance_index)
/// instance: u32)` and a fragment entry point `fs_main`. It may declare
/// ```text
/// struct Uniforms { tint: vec4<f32>, osg_SimulationTime: f32, ... }
/// @group(2) @binding(0) var<uniform> uniforms: Uniforms;              members are filled by name
/// @group(2) @binding(1 + 2 * unit) var picture: texture_2d<f32>;      textures of units 0 to 3, of any kind
/// @group(2) @binding(2 + 2 * unit) var picture_sampler: sampler;
/// override FANCY: bool = false;                                       set by defines
/// ```
/// The members `osg_FrameNumber` (u32), `osg_FrameTime`, `osg_DeltaFrameTime`, `osg_SimulationTime` (f32, seconds),
/// `osg_ViewMatrix` and `osg_ViewMatrixInverse` (mat4x4) are filled without being given.
///
/// What the vertices of a mesh have besides ([`Mesh::with_attribute`](crate::scene::Mesh::with_attribute)) `vs_main` reads
/// by name at any location from 4 on, in arguments or in members of a struct:
/// ```text
/// @vertex fn vs_main(vertex: MeshVertex, @location(4) TANGENT: vec4<f32>, @location(5) _HEAT: f32, ...)
/// ```
/// Their scalars are those of the attribute's format
/// ([`AttributeFormat::scalar`](crate::scene::AttributeFormat::scalar)); of a vector with more components than the
/// attribute those that lack are 0, 0 and 1. Meshes that have no such attribute, or one of other scalars, are drawn in
/// magenta, and said once.
///
/// Of a height tile, `vs_main` is called with its displaced and morphed vertices: position and normal in the tile's
/// frame, texture coordinates of its image, white. It may take `MeshVertex`, the vertex's index and the instance's, and
/// `@vertex` stands right before `fn vs_main`; a program that cannot be used so is said, and height tiles are plain.
/// Shadows of height tiles are those of their surface, whatever the program moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// For people, and for errors.
    pub name: String,
    /// The source.
    pub wgsl: String,
    /// Values of `override`s; those that the source does not declare are ignored.
    pub defines: Vec<(String, f64)>,
}

impl Program {
    /// A program without defines.
    pub fn new(name: &str, wgsl: &str) -> Arc<Self> {
        Arc::new(Self { name: name.into(), wgsl: wgsl.into(), defines: Vec::new() })
    }
}

/// The value of a uniform; vectors and matrices (by columns) of f32, i32 and u32.
#[allow(missing_docs, reason = "WGSL's types")]
#[derive(Clone, Debug, PartialEq)]
pub enum UniformValue {
    Float(f32),
    Vec2([f32; 2]),
    Vec3([f32; 3]),
    Vec4([f32; 4]),
    Int(i32),
    IVec2([i32; 2]),
    IVec3([i32; 3]),
    IVec4([i32; 4]),
    Uint(u32),
    UVec2([u32; 2]),
    UVec3([u32; 3]),
    UVec4([u32; 4]),
    Mat2([[f32; 2]; 2]),
    Mat3([[f32; 3]; 3]),
    Mat4([[f32; 4]; 4]),
    /// For `array<vec4<f32>, N>`.
    Vec4Array(Arc<[[f32; 4]]>),
}

impl UniformValue {
    /// Its bytes as WGSL lays the type out in a uniform, by columns of a matrix or elements of an array: the bytes of
    /// a column and the distance to the next.
    pub(crate) fn columns(&self) -> (&[u8], usize, usize) {
        match self {
            Self::Float(v) => (bytemuck::bytes_of(v), 4, 4),
            Self::Int(v) => (bytemuck::bytes_of(v), 4, 4),
            Self::Uint(v) => (bytemuck::bytes_of(v), 4, 4),
            Self::Vec2(v) => (bytemuck::cast_slice(v), 8, 8),
            Self::IVec2(v) => (bytemuck::cast_slice(v), 8, 8),
            Self::UVec2(v) => (bytemuck::cast_slice(v), 8, 8),
            Self::Vec3(v) => (bytemuck::cast_slice(v), 12, 12),
            Self::IVec3(v) => (bytemuck::cast_slice(v), 12, 12),
            Self::UVec3(v) => (bytemuck::cast_slice(v), 12, 12),
            Self::Vec4(v) => (bytemuck::cast_slice(v), 16, 16),
            Self::IVec4(v) => (bytemuck::cast_slice(v), 16, 16),
            Self::UVec4(v) => (bytemuck::cast_slice(v), 16, 16),
            Self::Mat2(v) => (bytemuck::cast_slice(v), 8, 8),
            Self::Mat3(v) => (bytemuck::cast_slice(v), 12, 16),
            Self::Mat4(v) => (bytemuck::cast_slice(v), 16, 16),
            Self::Vec4Array(v) => (bytemuck::cast_slice(v), 16, 16),
        }
    }

    /// WGSL's name of the type.
    pub(crate) fn type_name(&self) -> &'static str {
        match self {
            Self::Float(_) => "f32",
            Self::Int(_) => "i32",
            Self::Uint(_) => "u32",
            Self::Vec2(_) => "vec2<f32>",
            Self::Vec3(_) => "vec3<f32>",
            Self::Vec4(_) => "vec4<f32>",
            Self::IVec2(_) => "vec2<i32>",
            Self::IVec3(_) => "vec3<i32>",
            Self::IVec4(_) => "vec4<i32>",
            Self::UVec2(_) => "vec2<u32>",
            Self::UVec3(_) => "vec3<u32>",
            Self::UVec4(_) => "vec4<u32>",
            Self::Mat2(_) => "mat2x2<f32>",
            Self::Mat3(_) => "mat3x3<f32>",
            Self::Mat4(_) => "mat4x4<f32>",
            Self::Vec4Array(_) => "array<vec4<f32>>",
        }
    }
}

/// A named value for [`Program`]s.
#[derive(Clone, Debug, PartialEq)]
pub struct Uniform {
    /// Name of the member it fills.
    pub name: Arc<str>,
    /// Its value.
    pub value: UniformValue,
}
