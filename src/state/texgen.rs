//! Generated texture coordinates.

/// A generator of texture coordinates; OpenGL's `glTexGen`.
///
/// The four planes are for s, t, r and q. 2D and 3D textures are sampled at the coordinates divided by q, so that an
/// image can be projected. Cubes are sampled in the direction of s, t and r, arrays at s and t divided by q in the layer
/// nearest to r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TexGen {
    /// Distances from planes in the drawable's frame.
    ObjectLinear([[f32; 4]; 4]),
    /// Distances from planes in eye space, or in the frame of a TexGenNode.
    EyeLinear([[f32; 4]; 4]),
    /// The point of a sphere map that has the same reflection.
    SphereMap,
    /// The normal in eye space.
    NormalMap,
    /// The reflected view direction in eye space.
    ReflectionMap,
}

impl TexGen {
    /// Returns the planes for an image that is not projected: r is 0 and q is 1 everywhere.
    pub const fn planes(s: [f32; 4], t: [f32; 4]) -> [[f32; 4]; 4] {
        [s, t, [0.0; 4], [0.0, 0.0, 0.0, 1.0]]
    }
}
