// Meshes, lines and points.

struct MeshFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) uv: vec2<f32>,
    @location(3) color: vec4<f32>,
    // By value, not by leaf: a load from a buffer for each pixel is dear on software adapters.
    @location(4) @interpolate(flat) layer: u32,
    @location(5) @interpolate(flat) flags: u32,
    @location(6) @interpolate(flat) alpha_cutoff: f32,
}

@vertex
fn vs_mesh(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> MeshFragment {
    let leaf = leaves[instance];
    let in_eye = point_in_eye(leaf, vertex.position);
    return MeshFragment(
        frame.clip_from_eye * vec4<f32>(in_eye, 1.0),
        in_eye,
        direction_in_eye(leaf, vertex.normal.xyz),
        vertex.uv,
        vertex.color * leaf.color,
        leaf.layer,
        leaf.flags,
        leaf.alpha_cutoff,
    );
}

fn surface_normal(smooth_normal: vec3<f32>, is_front: bool, facet: vec3<f32>) -> vec3<f32> {
    if dot(smooth_normal, smooth_normal) <= 1e-12 {
        return facet;
    }
    let normal = normalize(smooth_normal);
    // Only pipelines that draw both sides see back faces. A mirroring transform swaps the sides, so the facet
    // decides: a smooth normal must lie on the side that is seen.
    return select(normal, -normal, dot(normal, facet) < 0.0 && !is_front);
}

fn shade(in: MeshFragment, is_front: bool, facet: vec3<f32>, base: vec4<f32>) -> vec3<f32> {
    var color = base.rgb;
    if (in.flags & FLAG_UNLIT) == 0u {
        color *= light(surface_normal(in.normal, is_front, facet), frame.up.xyz);
    }
    return mix(color, frame.horizon_color.rgb, haze(in.in_eye));
}

// The facet's normal, towards the eye.
fn facet_normal(in_eye: vec3<f32>) -> vec3<f32> {
    let across = cross(dpdx(in_eye), dpdy(in_eye));
    let size = length(across);
    if size < 1e-30 {
        return frame.up.xyz;
    }
    let normal = across / size;
    return select(normal, -normal, dot(normal, in_eye) > 0.0);
}

@fragment
fn fs_mesh(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let facet = facet_normal(in.in_eye);
    let base = textureSample(color_layers, color_sampler, in.uv, in.layer) * in.color;
    return vec4<f32>(shade(in, is_front, facet, base), 1.0);
}

@fragment
fn fs_mesh_masked(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let facet = facet_normal(in.in_eye);
    let base = textureSample(color_layers, color_sampler, in.uv, in.layer) * in.color;
    if base.a < in.alpha_cutoff {
        discard;
    }
    return vec4<f32>(shade(in, is_front, facet, base), 1.0);
}

@fragment
fn fs_mesh_blended(in: MeshFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let facet = facet_normal(in.in_eye);
    let base = textureSample(color_layers, color_sampler, in.uv, in.layer) * in.color;
    return vec4<f32>(shade(in, is_front, facet, base), base.a);
}

// Lines and points have no facets: without a normal they face up.
@fragment
fn fs_thin(in: MeshFragment) -> @location(0) vec4<f32> {
    let base = textureSample(color_layers, color_sampler, in.uv, in.layer) * in.color;
    return vec4<f32>(shade(in, true, frame.up.xyz, base), base.a);
}

// What cannot be drawn as it should is drawn like this.
@fragment
fn fs_fallback(in: MeshFragment) -> @location(0) vec4<f32> {
    return vec4<f32>(1.0, 0.0, 1.0, 1.0);
}
