// Meshes as casters of shadows: they draw depth alone.

@vertex
fn vs_mesh_caster(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> @builtin(position) vec4<f32> {
    let leaf = leaves[instance];
    return clip_of(leaf, point_in_eye(leaf, vertex.position));
}

@vertex
fn vs_mesh_caster_pulled(@builtin(vertex_index) index: u32, @builtin(instance_index) stride: u32) -> @builtin(position) vec4<f32> {
    let leaf = leaves[index / stride];
    return clip_of(leaf, point_in_eye(leaf, pulled_vertex(leaf, index % stride).position));
}

struct MaskedCaster {
    @builtin(position) position: vec4<f32>,
    @location(0) uv: vec2<f32>,
    @location(1) alpha: f32,
    // Layer, flags and bits of the alpha cutoff.
    @location(2) @interpolate(flat) leaf: vec3<u32>,
}

@vertex
fn vs_mesh_caster_masked(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> MaskedCaster {
    let leaf = leaves[instance];
    return MaskedCaster(
        clip_of(leaf, point_in_eye(leaf, vertex.position)),
        vertex.uv,
        vertex.color.a * leaf.color.a,
        vec3<u32>(leaf.layer, leaf.flags, leaf.alpha_cutoff),
    );
}

@fragment
fn fs_mesh_caster_masked(in: MaskedCaster) {
    let sampled = textureSample(color_layers, color_sampler, in.uv, in.leaf.x);
    if texel(sampled, in.leaf.y).a * in.alpha < bitcast<f32>(in.leaf.z) {
        discard;
    }
}
