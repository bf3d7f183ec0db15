// Height tiles that receive or cast shadows.

struct ShadowedHeightFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) uv: vec2<f32>,
    @location(1) sun: vec3<f32>,  // sun and sky are multiplied by the leaf's color
    @location(2) sky: vec3<f32>,
    @location(3) air: vec4<f32>,
    @location(4) in_eye: vec3<f32>,
    @location(5) normal: vec3<f32>,
    @location(6) @interpolate(flat) layer: u32,  // packed as in HeightFragment
}

@vertex
fn vs_height_shadowed(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> ShadowedHeightFragment {
    let leaf = leaves[instance];
    let point = height_point(index, instance);
    var out: ShadowedHeightFragment;
    out.position = clip_of(leaf, point.in_eye);
    out.uv = point.uv;
    out.sky = leaf.color.rgb;
    if (leaf.flags & FLAG_UNLIT) == 0u {
        let height = above_ground(point.in_eye).w;
        out.sun = light_of_sun(point.normal, point.up, height) * leaf.color.rgb;
        out.sky = light_of_sky(point.normal, point.up) * leaf.color.rgb;
    }
    out.air = aerial(point.in_eye);
    out.in_eye = point.in_eye;
    out.normal = point.normal;
    let flags = leaf.flags & (FLAG_UNLIT | FLAG_UNTEXTURED);
    out.layer = leaf.layer | flags << FLAGS_SHIFT | (leaf.flags >> BAND_SHIFT) << BAND_SHIFT;
    return out;
}

fn shadowed_height_color(in: ShadowedHeightFragment) -> vec4<f32> {
    let layer = in.layer & ((1u << FLAGS_SHIFT) - 1u);
    let base = texel(textureSample(color_layers, color_sampler, in.uv, layer), in.layer >> FLAGS_SHIFT);
    let facet = facet_normal(in.in_eye);
    var light = in.sky;
    // Points without sunlight need no look-up.
    if in.sun.r + in.sun.g + in.sun.b > 0.0 {
        light += in.sun * sun_shadow(in.in_eye, towards_sun(normalize(in.normal), facet));
    }
    return vec4<f32>(through_air(base.rgb * light, in.air), select(1.0, base.a, HAS_ALPHA));
}

@fragment
fn fs_height_shadowed(in: ShadowedHeightFragment) -> @location(0) vec4<f32> {
    return shadowed_height_color(in);
}

@fragment
fn fs_height_shadowed_fading(in: ShadowedHeightFragment) -> @location(0) vec4<f32> {
    let color = shadowed_height_color(in);
    if is_faded_out(in.position.xy, in.layer) {
        discard;
    }
    return color;
}

@vertex
fn vs_height_caster(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> @builtin(position) vec4<f32> {
    return clip_of(leaves[instance], height_point(index, instance).in_eye);
}
