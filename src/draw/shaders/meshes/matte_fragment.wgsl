// The fragments of matte materials and of the fixed function.

// Packed, since each location costs time for every triangle on software adapters.
struct MeshFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye_u: vec4<f32>,
    @location(1) normal_v: vec4<f32>,
    @location(2) color: vec4<f32>,
    // Layer, flags and bits of the alpha cutoff. They are passed by value, since a load from a buffer for each pixel is slow.
    @location(3) @interpolate(flat) leaf: vec3<u32>,
}

// Matte materials have one set of texture coordinates.
fn pass_second_uv(fragment: ptr<function, MeshFragment>, vertex: MeshVertex) {
}

// Sets the texture coordinates of a vertex that has one set of them.
fn set_uv(vertex: ptr<function, MeshVertex>, uv: vec2<f32>) {
    (*vertex).uv = uv;
}

