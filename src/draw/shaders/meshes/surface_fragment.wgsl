// The fragments of metallic-roughness surfaces.

// Packed, since each location costs time for every triangle on software adapters.
struct MeshFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye_u: vec4<f32>,
    @location(1) normal_v: vec4<f32>,
    @location(2) color: vec4<f32>,
    // Layer, flags and bits of the alpha cutoff. They are passed by value, since a load from a buffer for each pixel is slow.
    @location(3) @interpolate(flat) leaf: vec3<u32>,
    @location(4) second_uv: vec2<f32>,
}

fn mesh_fragment(vertex: MeshVertex, leaf: Leaf, alpha_cutoff: u32) -> MeshFragment {
    let in_eye = point_in_eye(leaf, vertex.position);
    return MeshFragment(
        clip_of(leaf, in_eye),
        vec4<f32>(in_eye, vertex.uv.x),
        vec4<f32>(normal_in_eye(leaf, vertex.normal.xyz), vertex.uv.y),
        vertex.color * leaf.color,
        vec3<u32>(leaf.layer, leaf.flags, alpha_cutoff),
        vertex.second_uv,
    );
}

// Sets the texture coordinates of a vertex that has one set of them.
fn set_uv(vertex: ptr<function, MeshVertex>, uv: vec2<f32>) {
    (*vertex).uv = uv;
    (*vertex).second_uv = uv;
}

