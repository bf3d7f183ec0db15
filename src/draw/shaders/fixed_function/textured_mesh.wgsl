// The vertices and fragments of meshes with texture units, which may have three sets of texture coordinates.

@group(1) @binding(0) var color_layers: texture_2d_array<f32>;
@group(1) @binding(1) var color_sampler: sampler;

struct MeshVertex {
    @location(0) position: vec3<f32>,
    @location(1) uv: vec2<f32>,
    @location(2) normal: vec4<f32>,
    @location(3) color: vec4<f32>,
    // The first texture coordinates again if the mesh has no others.
    @location(4) second_uv: vec2<f32>,
    @location(5) third_uv: vec2<f32>,
}

struct MeshFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye_u: vec4<f32>,
    @location(1) normal_v: vec4<f32>,
    @location(2) color: vec4<f32>,
    @location(3) @interpolate(flat) leaf: vec3<u32>,
    @location(4) other_uvs: vec4<f32>,
}

fn pass_second_uv(fragment: ptr<function, MeshFragment>, vertex: MeshVertex) {
    (*fragment).other_uvs = vec4<f32>(vertex.second_uv, vertex.third_uv);
}

// Sets the texture coordinates of a vertex that has one set of them.
fn set_uv(vertex: ptr<function, MeshVertex>, uv: vec2<f32>) {
    (*vertex).uv = uv;
    (*vertex).second_uv = uv;
    (*vertex).third_uv = uv;
}

struct FixedMeshFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye_u: vec4<f32>,
    @location(1) normal_v: vec4<f32>,
    @location(2) color: vec4<f32>,
    @location(3) @interpolate(flat) leaf: vec3<u32>,
    @location(4) object: vec3<f32>,
    @location(5) other_uvs: vec4<f32>,
}

fn fixed_fragment(f: MeshFragment, object: vec3<f32>) -> FixedMeshFragment {
    return FixedMeshFragment(f.position, f.in_eye_u, f.normal_v, f.color, f.leaf, object, f.other_uvs);
}

fn other_uvs(in: FixedMeshFragment) -> vec4<f32> {
    return in.other_uvs;
}
