// Height tiles under the fixed function.

struct FixedHeightFragment {
    @builtin(position) position: vec4<f32>,
    @location(0) in_eye: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) up: vec3<f32>,
    @location(3) uv: vec2<f32>,
    @location(4) in_tile: vec3<f32>,
    @location(5) @interpolate(flat) layer: u32,
    @location(6) @interpolate(flat) flags: u32,
    @location(7) @interpolate(flat) color: vec4<f32>,
}

@vertex
fn vs_fixed_height(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> FixedHeightFragment {
    let leaf = leaves[instance];
    let point = height_point(index, instance);
    return FixedHeightFragment(
        clip_of(leaf, point.in_eye),
        point.in_eye,
        point.normal,
        point.up,
        point.uv,
        point.in_tile,
        leaf.layer,
        leaf.flags,
        leaf.color,
    );
}

fn fixed_height_surface(in: FixedHeightFragment, is_front: bool) -> Surface {
    let texel = texel(textureSample(color_layers, color_sampler, in.uv, in.layer), in.flags);
    let is_lit = (in.flags & FLAG_UNLIT) == 0u;
    let is_back = is_back(is_front);
    let smooth_normal = normalize(in.normal);
    let normal = select(smooth_normal, -smooth_normal, is_back);
    let facing = towards_sun(normal, facet_normal(in.in_eye));
    let up = normalize(in.up);
    return Surface(in.in_eye, normal, facing, up, in.in_tile, in.uv, in.uv.xyxy, texel, in.color, is_lit, is_back, 0.0);
}

@fragment
fn fs_fixed_height_caster(in: FixedHeightFragment, @builtin(front_facing) is_front: bool) {
    if is_hole(fixed_height_surface(in, is_front)) {
        discard;
    }
}

@fragment
fn fs_fixed_height(in: FixedHeightFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    return fixed_color(fixed_height_surface(in, is_front));
}

@fragment
fn fs_fixed_height_fading(in: FixedHeightFragment, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let color = fixed_color(fixed_height_surface(in, is_front));
    if is_left_out(in.position.xy, in.in_eye, in.flags) {
        discard;
    }
    return color;
}
