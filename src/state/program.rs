//! Programs and uniforms: shading by the application.

use std::sync::Arc;

/// WGSL that replaces the shading of meshes and height tiles.
///
/// The source is appended to `shared/frame.wgsl` and `meshes/mesh_vertex.wgsl` in `src/draw/shaders`, which declare `frame`,
/// `leaves`, `MeshVertex` and `point_in_eye`. It has a vertex entry point `vs_main(vertex: MeshVertex, @builtin(instance_index)
/// instance: u32)` and a fragment entry point `fs_main`. It may declare
/// ```text
/// struct Uniforms { tint: vec4<f32>, osg_SimulationTime: f32, ... }
/// @group(2) @binding(0) var<uniform> uniforms: Uniforms;              members are filled by name
/// @group(2) @binding(1 + 2 * unit) var image: texture_2d<f32>;        textures of units 0 to 3, of any kind
/// @group(2) @binding(2 + 2 * unit) var image_sampler: sampler;
/// @group(3) @binding(n) ...                                           an attribute of the application's own
/// override FANCY: bool = false;                                       set by defines
/// ```
/// The members `osg_FrameNumber` (u32), `osg_FrameTime`, `osg_DeltaFrameTime`, `osg_SimulationTime` (f32, seconds),
/// `osg_ViewMatrix` and `osg_ViewMatrixInverse` (mat4x4) are filled without being given. The translations of the two matrices
/// are `f32`, whose step is 0.5 m at an earth-centred eye. For positions in the world there are `terrane_WorldFromEye`
/// (mat3x3), the rotation, and the eye's position as the sum of `terrane_EyeHigh` and `terrane_EyeLow` (vec3, metres): the
/// first is the nearest `f32`, the second the rest, exact to a micrometre. A position in the world is
/// `terrane_EyeHigh + (terrane_EyeLow + terrane_WorldFromEye * point_in_eye)`; a shader reduces the first term alone, for
/// example modulo a period, before it adds the other (example `world_grid`).
///
/// Custom vertex attributes ([`Mesh::with_attribute`](crate::scene::Mesh::with_attribute)) are read by name at any
/// location from 4 on, as arguments of `vs_main` or as members of a struct:
/// ```text
/// @vertex fn vs_main(vertex: MeshVertex, @location(4) TANGENT: vec4<f32>, @location(5) _HEAT: f32, ...)
/// ```
/// The scalar type must be that of the attribute's format
/// ([`AttributeFormat::scalar`](crate::scene::AttributeFormat::scalar)). Components that the attribute lacks are 0, 0
/// and 1. Meshes without such an attribute, or with another scalar type, are drawn in magenta and reported once.
///
/// For a height tile, `vs_main` is called with displaced and morphed vertices: position and normal in the tile's frame,
/// texture coordinates of its image, and white. Its arguments may then be `MeshVertex`, the vertex index and the
/// instance index, and `@vertex` must stand directly before `fn vs_main`. A program that breaks these rules is reported,
/// and height tiles are drawn without it. Shadows of height tiles ignore displacements by the program.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// The name in logs and errors.
    pub name: String,
    /// The source text.
    pub wgsl: String,
    /// Values of `override` constants; names that the source does not declare are ignored.
    pub defines: Vec<(String, f64)>,
}

impl Program {
    /// Creates a program without defines.
    pub fn new(name: &str, wgsl: &str) -> Arc<Self> {
        Arc::new(Self { name: name.into(), wgsl: wgsl.into(), defines: Vec::new() })
    }
}

/// Declares the variants of [`UniformValue`]: type, WGSL name, and the size and stride in bytes of a matrix column or array
/// element in WGSL's uniform layout.
macro_rules! uniform_values {
    (values { $($value:ident($ty:ty) $wgsl:literal $column:literal $stride:literal,)+ }
     arrays { $($array:ident($of:ty) $of_wgsl:literal $of_column:literal $of_stride:literal,)+ }) => {
        /// The value of a uniform: a scalar, vector or matrix of f32, i32 or u32, or an array. Matrices are given by columns;
        /// `Mat2x3` has two columns of three rows.
        ///
        /// Arrays are limited to WGSL's uniform layout: elements take a multiple of 16 bytes. An array that is shorter than
        /// declared is filled with zeros, and a longer one is truncated.
        #[allow(missing_docs, reason = "WGSL's types")]
        #[derive(Clone, Debug, PartialEq)]
        pub enum UniformValue {
            $($value($ty),)+
            $($array(Arc<[$of]>),)+
        }

        impl UniformValue {
            /// Returns the bytes, the size of one column or element, and the stride to the next in the uniform buffer.
            pub(crate) fn columns(&self) -> (&[u8], usize, usize) {
                match self {
                    $(Self::$value(v) => (bytemuck::bytes_of(v), $column, $stride),)+
                    $(Self::$array(v) => (bytemuck::cast_slice(v), $of_column, $of_stride),)+
                }
            }

            /// Returns the WGSL name of the type; arrays without their length.
            pub(crate) fn type_name(&self) -> &'static str {
                match self {
                    $(Self::$value(_) => $wgsl,)+
                    $(Self::$array(_) => concat!("array<", $of_wgsl, ">"),)+
                }
            }
        }
    };
}

uniform_values! {
    values {
        Float(f32) "f32" 4 4,
        Vec2([f32; 2]) "vec2<f32>" 8 8,
        Vec3([f32; 3]) "vec3<f32>" 12 12,
        Vec4([f32; 4]) "vec4<f32>" 16 16,
        Int(i32) "i32" 4 4,
        IVec2([i32; 2]) "vec2<i32>" 8 8,
        IVec3([i32; 3]) "vec3<i32>" 12 12,
        IVec4([i32; 4]) "vec4<i32>" 16 16,
        Uint(u32) "u32" 4 4,
        UVec2([u32; 2]) "vec2<u32>" 8 8,
        UVec3([u32; 3]) "vec3<u32>" 12 12,
        UVec4([u32; 4]) "vec4<u32>" 16 16,
        Mat2([[f32; 2]; 2]) "mat2x2<f32>" 8 8,
        Mat2x3([[f32; 3]; 2]) "mat2x3<f32>" 12 16,
        Mat2x4([[f32; 4]; 2]) "mat2x4<f32>" 16 16,
        Mat3x2([[f32; 2]; 3]) "mat3x2<f32>" 8 8,
        Mat3([[f32; 3]; 3]) "mat3x3<f32>" 12 16,
        Mat3x4([[f32; 4]; 3]) "mat3x4<f32>" 16 16,
        Mat4x2([[f32; 2]; 4]) "mat4x2<f32>" 8 8,
        Mat4x3([[f32; 3]; 4]) "mat4x3<f32>" 12 16,
        Mat4([[f32; 4]; 4]) "mat4x4<f32>" 16 16,
    }
    arrays {
        Vec3Array([f32; 3]) "vec3<f32>" 12 16,
        Vec4Array([f32; 4]) "vec4<f32>" 16 16,
        IVec3Array([i32; 3]) "vec3<i32>" 12 16,
        IVec4Array([i32; 4]) "vec4<i32>" 16 16,
        UVec3Array([u32; 3]) "vec3<u32>" 12 16,
        UVec4Array([u32; 4]) "vec4<u32>" 16 16,
        Mat2Array([[f32; 2]; 2]) "mat2x2<f32>" 8 8,
        Mat2x3Array([[f32; 3]; 2]) "mat2x3<f32>" 12 16,
        Mat2x4Array([[f32; 4]; 2]) "mat2x4<f32>" 16 16,
        Mat3Array([[f32; 3]; 3]) "mat3x3<f32>" 12 16,
        Mat3x4Array([[f32; 4]; 3]) "mat3x4<f32>" 16 16,
        Mat4x2Array([[f32; 2]; 4]) "mat4x2<f32>" 8 8,
        Mat4x3Array([[f32; 3]; 4]) "mat4x3<f32>" 12 16,
        Mat4Array([[f32; 4]; 4]) "mat4x4<f32>" 16 16,
    }
}

/// A named value for [`Program`]s.
#[derive(Clone, Debug, PartialEq)]
pub struct Uniform {
    /// The name of the struct member.
    pub name: Arc<str>,
    /// The value.
    pub value: UniformValue,
}
