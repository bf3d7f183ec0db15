// Meshes, lines and points. What a fragment has is in matte_fragment.wgsl or surface_fragment.wgsl: `MeshFragment`,
// `pass_second_uv` and `set_uv`. The material's model is in matte.wgsl or surface.wgsl: `MeshShape`, `mesh_shape`, `thin_shape`,
// `base_color` and `shade`.

fn mesh_fragment(vertex: MeshVertex, leaf: Leaf, alpha_cutoff: u32) -> MeshFragment {
    let in_eye = point_in_eye(leaf, vertex.position);
    var fragment: MeshFragment;
    fragment.position = clip_of(leaf, in_eye);
    fragment.in_eye_u = vec4<f32>(in_eye, vertex.uv.x);
    fragment.normal_v = vec4<f32>(normal_in_eye(leaf, vertex.normal.xyz), vertex.uv.y);
    fragment.color = vertex.color * leaf.color;
    fragment.leaf = vec3<u32>(leaf.layer, leaf.flags, alpha_cutoff);
    pass_second_uv(&fragment, vertex);
    return fragment;
}

@vertex
fn vs_mesh(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> MeshFragment {
    let leaf = leaves[instance];
    return mesh_fragment(vertex, leaf, leaf.alpha_cutoff);
}

// Many small meshes are drawn by one call: each has `stride` of its vertices, which are fetched here. The call's one instance
// has the stride as its index.
@vertex
fn vs_mesh_pulled(@builtin(vertex_index) index: u32, @builtin(instance_index) stride: u32) -> MeshFragment {
    let leaf = leaves[index / stride];
    return mesh_fragment(pulled_vertex(leaf, index % stride), leaf, 0u);
}

// A corner of a square around a point. The texture coordinates are its offset from the point in pixels.
fn square_fragment(vertex: MeshVertex, leaf: Leaf) -> MeshFragment {
    var point = vertex;
    point.uv = vec2<f32>(0.0);
    var fragment = mesh_fragment(point, leaf, leaf.alpha_cutoff);
    let offset = vertex.uv * frame.middle_ray.zw * fragment.position.w;
    fragment.position += vec4<f32>(offset, 0.0, 0.0);
    return fragment;
}

@vertex
fn vs_square(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> MeshFragment {
    return square_fragment(vertex, leaves[instance]);
}

// Returns the normal of a surface in eye space; the facet's if the mesh has none.
fn surface_normal(smooth_normal: vec3<f32>, is_front: bool, facet: vec3<f32>) -> vec3<f32> {
    if dot(smooth_normal, smooth_normal) <= 1e-12 {
        return facet;
    }
    let normal = normalize(smooth_normal);
    // Back faces occur in pipelines without culling only. A mirroring transform swaps the sides, so that the facet decides:
    // the smooth normal must lie on the visible side.
    return select(normal, -normal, dot(normal, facet) < 0.0 && !is_front);
}

fn mesh_color(in: MeshFragment, is_front: bool) -> vec4<f32> {
    let shape = mesh_shape(in);
    let base = base_color(in);
    return vec4<f32>(shade(in, is_front, shape, base), base.a);
}

// Returns the colour of lines and points. They have no facets; without a normal they face up.
fn thin_color(in: MeshFragment) -> vec4<f32> {
    let base = base_color(in);
    return vec4<f32>(shade(in, true, thin_shape(), base), base.a);
}

@fragment
fn fs_mesh(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    return vec4<f32>(mesh_color(in, is_front).rgb, 1.0);
}

@fragment
fn fs_mesh_fading(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let color = mesh_color(in, is_front);
    if is_left_out(in.position.xy, in.in_eye_u.xyz, in.leaf.y) {
        discard;
    }
    return vec4<f32>(color.rgb, 1.0);
}

@fragment
fn fs_mesh_masked(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    // Derivatives are taken before the discard.
    let shape = mesh_shape(in);
    let base = base_color(in);
    if base.a < bitcast<f32>(in.leaf.z) {
        discard;
    }
    return vec4<f32>(shade(in, is_front, shape, base), 1.0);
}

@fragment
fn fs_mesh_masked_fading(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let color = mesh_color(in, is_front);
    if color.a < bitcast<f32>(in.leaf.z) || is_left_out(in.position.xy, in.in_eye_u.xyz, in.leaf.y) {
        discard;
    }
    return vec4<f32>(color.rgb, 1.0);
}

@fragment
fn fs_mesh_blended(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    return mesh_color(in, is_front);
}

@fragment
fn fs_mesh_blended_fading(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let color = mesh_color(in, is_front);
    if is_left_out(in.position.xy, in.in_eye_u.xyz, in.leaf.y) {
        discard;
    }
    return color;
}

// A masked material that its state set blends.
@fragment
fn fs_mesh_masked_blended(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let color = mesh_color(in, is_front);
    if color.a < bitcast<f32>(in.leaf.z) {
        discard;
    }
    return color;
}

@fragment
fn fs_mesh_masked_blended_fading(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let color = mesh_color(in, is_front);
    if color.a < bitcast<f32>(in.leaf.z) || is_left_out(in.position.xy, in.in_eye_u.xyz, in.leaf.y) {
        discard;
    }
    return color;
}

@fragment
fn fs_thin(in: MeshFragment) -> @location(0) vec4<f32> {
    return thin_color(in);
}

@fragment
fn fs_thin_fading(in: MeshFragment) -> @location(0) vec4<f32> {
    let color = thin_color(in);
    if is_left_out(in.position.xy, in.in_eye_u.xyz, in.leaf.y) {
        discard;
    }
    return color;
}

// Marks leaves whose shader is invalid with magenta.
@fragment
fn fs_fallback(in: MeshFragment) -> @location(0) vec4<f32> {
    return vec4<f32>(1.0, 0.0, 1.0, 1.0);
}
