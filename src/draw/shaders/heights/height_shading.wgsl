// Height tiles under sun, sky and air. All of it is computed for each pixel, so that the image does not depend on the size of
// the triangles, which is that of the level. The normal is interpolated between vertices: a tile has one height for each
// vertex, so that its normals hold no more. It morphs with the surface, so that shading does not jump where levels change.

// Packed, since each location costs time for every triangle on software adapters.
struct HeightFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye_u: vec4<f32>,
    @location(1) normal_v: vec4<f32>,
    // The bits of the leaf's color. w: the layer, two flags from FLAGS_SHIFT on, and the band of a fade at the same bits as in
    // the leaf. They are passed by value, since a load from a buffer for each pixel is slow on software adapters.
    @location(2) @interpolate(flat) leaf: vec4<u32>,
}

const FLAGS_SHIFT: u32 = 14u;

@vertex
fn vs_height(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> HeightFragment {
    let leaf = leaves[instance];
    let point = height_point(index, instance);
    let flags = leaf.flags & (FLAG_UNLIT | FLAG_UNTEXTURED);
    let layer = leaf.layer | flags << FLAGS_SHIFT | (leaf.flags >> BAND_SHIFT) << BAND_SHIFT;
    return HeightFragment(
        clip_of(leaf, point.in_eye),
        vec4<f32>(point.in_eye, point.uv.x),
        vec4<f32>(point.normal, point.uv.y),
        vec4<u32>(bitcast<vec3<u32>>(leaf.color.rgb), layer),
    );
}

// True if the image's alpha is used, for blending or coverage.
override HAS_ALPHA: bool = false;

fn height_color(in: HeightFragment) -> vec4<f32> {
    let in_eye = in.in_eye_u.xyz;
    let uv = vec2<f32>(in.in_eye_u.w, in.normal_v.w);
    let layer = in.leaf.w & ((1u << FLAGS_SHIFT) - 1u);
    let flags = in.leaf.w >> FLAGS_SHIFT;
    // Derivatives are taken before any branch.
    let image = texel(textureSample(color_layers, color_sampler, uv, layer), flags);
    let facet = facet_normal(in_eye);
    let base = image.rgb * bitcast<vec3<f32>>(in.leaf.xyz);
    let alpha = select(1.0, image.a, HAS_ALPHA);
    let air = aerial(in_eye);
    if (flags & FLAG_UNLIT) != 0u {
        return vec4<f32>(unlit_through_air(base, air), alpha);
    }
    let normal = normalize(in.normal_v.xyz);
    let ground = above_ground(in_eye);
    var lit = light_of_sky(normal, ground.xyz) + local_light(in_eye, normal);
    // Points that the sun does not reach need no look-ups.
    if dot(normal, frame.sun_direction.xyz) > 0.0 {
        lit += light_of_sun(normal, ground.xyz, ground.w) * sun_shadow(in_eye, towards_sun(normal, facet));
    }
    return vec4<f32>(through_air(base * lit, air), alpha);
}

@fragment
fn fs_height(in: HeightFragment) -> @location(0) vec4<f32> {
    return height_color(in);
}

@fragment
fn fs_height_fading(in: HeightFragment) -> @location(0) vec4<f32> {
    let color = height_color(in);
    if is_left_out(in.position.xy, in.in_eye_u.xyz, in.leaf.w) {
        discard;
    }
    return color;
}

@vertex
fn vs_height_caster(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> @builtin(position) vec4<f32> {
    return clip_of(leaves[instance], height_point(index, instance).in_eye);
}
