// The fragments of meshes under the fixed function without texture units.

struct FixedMeshFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye_u: vec4<f32>,
    @location(1) normal_v: vec4<f32>,
    @location(2) color: vec4<f32>,
    @location(3) @interpolate(flat) leaf: vec3<u32>,
    @location(4) object: vec3<f32>,
}

fn fixed_fragment(f: MeshFragment, object: vec3<f32>) -> FixedMeshFragment {
    return FixedMeshFragment(f.position, f.in_eye_u, f.normal_v, f.color, f.leaf, object);
}

fn other_uvs(in: FixedMeshFragment) -> vec4<f32> {
    return vec4<f32>(0.0);
}
