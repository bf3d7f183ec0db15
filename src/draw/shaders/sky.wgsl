// The sky: one triangle behind everything, coloured by the direction each pixel looks in.

struct SkyVertex {
    @builtin(position) position: vec4<f32>,
    @location(0) ray: vec2<f32>,
}

@vertex
fn vs_sky(@builtin(vertex_index) index: u32) -> SkyVertex {
    let xy = vec2<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0);
    // Reversed-Z: depth 0 is infinitely far.
    return SkyVertex(vec4<f32>(xy, 0.0, 1.0), xy * frame.ray.xy + frame.ray.zw);
}

// The sky's colour in a direction of eye space, without the sun.
fn sky_color(ray: vec3<f32>) -> vec3<f32> {
    // Height above the horizon, which from high up lies below the level.
    let above = dot(ray, frame.up.xyz) + frame.horizon.x;
    let air = frame.horizon.y;
    let t = 1.0 - exp(-max(above, 0.0) / frame.horizon.z);
    var color = mix(frame.horizon_color.rgb, frame.zenith_color.rgb, t);
    // Below the horizon: ground that is not there, in haze.
    color *= mix(1.0, mix(0.15, 0.55, air), smoothstep(0.0, -1.2 * frame.horizon.z, above));
    return color;
}

@fragment
fn fs_sky(in: SkyVertex) -> @location(0) vec4<f32> {
    let ray = normalize(vec3<f32>(in.ray, -1.0));
    let color = sky_color(ray);
    let above = dot(ray, frame.up.xyz) + frame.horizon.x;
    let air = frame.horizon.y;
    let toward_sun = max(dot(ray, frame.sun_direction.xyz), 0.0);
    let glow = 0.25 * pow(toward_sun, 24.0) * max(air, 0.1) + 4.0 * pow(toward_sun, 3000.0);
    // The sky's own colours are those of a picture already; the sun's are light.
    let sun = frame.sun_color.rgb * glow * smoothstep(-0.02, 0.02, above);
    return vec4<f32>(color + tone_mapped(color + sun) - tone_mapped(color), 1.0);
}
