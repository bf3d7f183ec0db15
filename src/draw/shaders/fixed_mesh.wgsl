// Meshes, lines and points under the fixed function.

struct FixedMeshFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) uv: vec2<f32>,
    @location(3) color: vec4<f32>,
    @location(4) @interpolate(flat) layer: u32,
    @location(5) @interpolate(flat) flags: u32,
    @location(6) @interpolate(flat) alpha_cutoff: f32,
    @location(7) object: vec3<f32>,
}

@vertex
fn vs_fixed_mesh(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> FixedMeshFragment {
    let leaf = leaves[instance];
    let in_eye = point_in_eye(leaf, vertex.position);
    return FixedMeshFragment(
        frame.clip_from_eye * vec4<f32>(in_eye, 1.0),
        in_eye,
        direction_in_eye(leaf, vertex.normal.xyz),
        vertex.uv,
        vertex.color * leaf.color,
        leaf.layer,
        leaf.flags,
        leaf.alpha_cutoff,
        vertex.position,
    );
}

fn mesh_surface(in: FixedMeshFragment, normal: vec3<f32>) -> Surface {
    let base = textureSample(color_layers, color_sampler, in.uv, in.layer) * in.color;
    let is_lit = (in.flags & FLAG_UNLIT) == 0u;
    return Surface(in.in_eye, normal, frame.up.xyz, in.object, in.uv, base, is_lit, in.alpha_cutoff);
}

@fragment
fn fs_fixed_mesh(in: FixedMeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let normal = surface_normal(in.normal, is_front, facet_normal(in.in_eye));
    return fixed_color(mesh_surface(in, normal));
}

@fragment
fn fs_fixed_thin(in: FixedMeshFragment) -> @location(0) vec4<f32> {
    return fixed_color(mesh_surface(in, frame.up.xyz));
}
