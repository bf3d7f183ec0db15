// Meshes, lines and points under the fixed function. What a fragment has is in untextured_mesh.wgsl or textured_mesh.wgsl:
// `FixedMeshFragment`, `fixed_fragment` and `other_uvs`.

fn fixed_mesh_fragment(vertex: MeshVertex, leaf: Leaf, alpha_cutoff: u32) -> FixedMeshFragment {
    return fixed_fragment(mesh_fragment(vertex, leaf, alpha_cutoff), vertex.position);
}

@vertex
fn vs_fixed_square(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> FixedMeshFragment {
    return fixed_fragment(square_fragment(vertex, leaves[instance]), vertex.position);
}

@vertex
fn vs_fixed_mesh(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> FixedMeshFragment {
    let leaf = leaves[instance];
    return fixed_mesh_fragment(vertex, leaf, leaf.alpha_cutoff);
}

@vertex
fn vs_fixed_mesh_pulled(@builtin(vertex_index) index: u32, @builtin(instance_index) stride: u32) -> FixedMeshFragment {
    let leaf = leaves[index / stride];
    return fixed_mesh_fragment(pulled_vertex(leaf, index % stride), leaf, 0u);
}

fn mesh_surface(in: FixedMeshFragment, normal: vec3<f32>, facing: vec3<f32>, is_front: bool) -> Surface {
    let uv = vec2<f32>(in.in_eye_u.w, in.normal_v.w);
    let texel = texel(textureSample(color_layers, color_sampler, uv, in.leaf.x), in.leaf.y);
    let is_lit = (in.leaf.y & FLAG_UNLIT) == 0u;
    let cutoff = bitcast<f32>(in.leaf.z);
    let in_eye = in.in_eye_u.xyz;
    let up = above_ground(in_eye).xyz;
    let others = other_uvs(in);
    return Surface(in_eye, normal, facing, up, in.object, uv, others, texel, in.color, is_lit, is_back(is_front), cutoff);
}

// Returns the normal of the lit side.
fn lit_normal(smooth_normal: vec3<f32>, is_front: bool, facet: vec3<f32>) -> vec3<f32> {
    if fixed_state.model.y != FRONT_ONLY {
        return surface_normal(smooth_normal, is_front, facet);
    }
    if dot(smooth_normal, smooth_normal) <= 1e-12 {
        return select(-facet, facet, is_front);
    }
    return normalize(smooth_normal);
}

fn fixed_mesh_color(in: FixedMeshFragment, is_front: bool) -> vec4<f32> {
    let facet = facet_normal(in.in_eye_u.xyz);
    let normal = lit_normal(in.normal_v.xyz, is_front, facet);
    return fixed_color(mesh_surface(in, normal, towards_sun(normal, facet), is_front));
}

@fragment
fn fs_fixed_mesh(in: FixedMeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    return fixed_mesh_color(in, is_front);
}

@fragment
fn fs_fixed_mesh_fading(in: FixedMeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let color = fixed_mesh_color(in, is_front);
    if is_left_out(in.position.xy, in.in_eye_u.xyz, in.leaf.y) {
        discard;
    }
    return color;
}

// Returns the colour of lines and points. They have no facets; without a normal they face up.
fn fixed_thin_color(in: FixedMeshFragment) -> vec4<f32> {
    let normal = surface_normal(in.normal_v.xyz, true, frame.up.xyz);
    return fixed_color(mesh_surface(in, normal, towards_sun(normal, frame.up.xyz), true));
}

@fragment
fn fs_fixed_thin(in: FixedMeshFragment) -> @location(0) vec4<f32> {
    return fixed_thin_color(in);
}

@fragment
fn fs_fixed_mesh_caster(in: FixedMeshFragment, @builtin(front_facing) is_front: bool) {
    let facet = facet_normal(in.in_eye_u.xyz);
    if is_hole(mesh_surface(in, lit_normal(in.normal_v.xyz, is_front, facet), facet, is_front)) {
        discard;
    }
}

@fragment
fn fs_fixed_thin_fading(in: FixedMeshFragment) -> @location(0) vec4<f32> {
    let color = fixed_thin_color(in);
    if is_left_out(in.position.xy, in.in_eye_u.xyz, in.leaf.y) {
        discard;
    }
    return color;
}
