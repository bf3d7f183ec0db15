// Shadows of the sun from cascaded shadow maps. Depths are reversed: 1 is nearest to the sun.

@group(0) @binding(8) var sun_shadow_maps: texture_depth_2d_array;
@group(0) @binding(9) var sun_shadow_sampler: sampler_comparison;

// Returns the share of the sun's light that reaches an eye-space point of a surface with a normal. Programs may call it.
fn sun_shadow(in_eye: vec3<f32>, normal: vec3<f32>) -> f32 {
    let depth = -in_eye.z;
    let last = i32(frame.shadow.x) - 1;
    if last < 0 || depth >= frame.shadow.w {
        return 1.0;
    }
    var cascade = 0;
    while cascade < last && depth > frame.cascade_scales[cascade].z {
        cascade++;
    }
    var share = sun_shadow_in(cascade, in_eye, normal);
    let scales = frame.cascade_scales[cascade];
    let into_next = (depth - scales.w) / (scales.z - scales.w);
    if into_next > 0.0 && cascade < last {
        share = mix(share, sun_shadow_in(cascade + 1, in_eye, normal), into_next);
    }
    return mix(share, 1.0, clamp((depth - frame.shadow.z) / (frame.shadow.w - frame.shadow.z), 0.0, 1.0));
}

// Returns the share in one cascade. A texel of the map holds one depth for a piece of surface that may be oblique to it. So
// the point is moved along the normal by the reach of the filter times the sine of the sun's angle. That puts it in front
// of the nearest end of that piece. The filter is a square and reaches farther towards its corners.
fn sun_shadow_in(cascade: i32, in_eye: vec3<f32>, normal: vec3<f32>) -> f32 {
    let sun = frame.sun_direction.xyz;
    let scales = frame.cascade_scales[cascade];
    let offsets = frame.cascade_offsets[cascade];
    let slant = abs(dot(frame.shadow_x.xyz, normal)) + abs(dot(frame.shadow_y.xyz, normal));
    let moved = in_eye + (frame.shadow_x.w * slant * normal + frame.shadow_y.w * sun) * offsets.w;
    let across = vec2<f32>(dot(frame.shadow_x.xyz, moved), -dot(frame.shadow_y.xyz, moved));
    return sun_shadow_filtered(cascade, across * scales.x + offsets.xy, dot(sun, moved) * scales.y + offsets.z);
}

// Returns the share by a tent filter over 5 x 5 texels: nine comparisons of 2 x 2 texels each, whose positions and weights
// account for the sampler's own weights (I. Castano, Shadow Mapping Summary, 2013).
fn sun_shadow_filtered(cascade: i32, uv: vec2<f32>, depth: f32) -> f32 {
    let texel = frame.shadow.y;
    let corner = floor(uv / texel + 0.5);
    let part = uv / texel + 0.5 - corner;
    let base = (corner - 0.5) * texel;
    let weights_x = vec3<f32>(4.0 - 3.0 * part.x, 7.0, 1.0 + 3.0 * part.x);
    let weights_y = vec3<f32>(4.0 - 3.0 * part.y, 7.0, 1.0 + 3.0 * part.y);
    let x = (vec3<f32>(3.0 - 2.0 * part.x, 3.0 + part.x, part.x) / weights_x + vec3<f32>(-2.0, 0.0, 2.0)) * texel;
    let y = (vec3<f32>(3.0 - 2.0 * part.y, 3.0 + part.y, part.y) / weights_y + vec3<f32>(-2.0, 0.0, 2.0)) * texel;
    let layer = cascade + i32(frame.sun_top.w);
    var sum = 0.0;
    for (var row = 0; row < 3; row++) {
        let at = base + vec2<f32>(0.0, y[row]);
        let lit = vec3<f32>(
            textureSampleCompareLevel(sun_shadow_maps, sun_shadow_sampler, at + vec2<f32>(x.x, 0.0), layer, depth),
            textureSampleCompareLevel(sun_shadow_maps, sun_shadow_sampler, at + vec2<f32>(x.y, 0.0), layer, depth),
            textureSampleCompareLevel(sun_shadow_maps, sun_shadow_sampler, at + vec2<f32>(x.z, 0.0), layer, depth),
        );
        sum += weights_y[row] * dot(weights_x, lit);
    }
    return sum / 144.0;
}
