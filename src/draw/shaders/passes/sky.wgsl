// The sky: one triangle at infinite distance, coloured by the direction of each pixel's ray.

struct SkyVertex {
    @builtin(position) position: vec4<f32>,
    // The point at which a pixel's ray meets the plane one metre in front of the eye; the eye's own plane if rays are
    // parallel.
    @location(0) ray: vec2<f32>,
}

// The ray of a pixel in eye space.
struct Ray {
    origin: vec3<f32>,
    direction: vec3<f32>,
}

fn ray_of(ray: vec2<f32>) -> Ray {
    if frame.air.w > 0.0 {
        return Ray(vec3<f32>(ray, 0.0), vec3<f32>(0.0, 0.0, -1.0));
    }
    return Ray(vec3<f32>(0.0), normalize(vec3<f32>(ray, -1.0)));
}

@vertex
fn vs_sky(@builtin(vertex_index) index: u32) -> SkyVertex {
    let xy = vec2<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0);
    // Reversed-Z: depth 0 is infinitely far.
    return SkyVertex(vec4<f32>(xy, 0.0, 1.0), xy.x * frame.ray.xy + xy.y * frame.ray.zw + frame.middle_ray.xy);
}

// Returns the sky's light from a direction of eye space, without the sun's disc.
fn sky_color(ray: vec3<f32>) -> vec3<f32> {
    return air_along(ray, max(dot(ray, frame.up.xyz), frame.air.y), 1.0).rgb;
}

@fragment
fn fs_sky(in: SkyVertex) -> @location(0) vec4<f32> {
    let ray = ray_of(in.ray).direction;
    let cosine = dot(ray, frame.up.xyz);
    let air = air_along(ray, cosine, 1.0);
    var beyond = vec3<f32>(0.0);
    if cosine >= frame.air.y {
        let height = frame.air.x - EARTH_KM;
        let left = textureSampleLevel(sunlight, air_sampler, sunlight_place(height, cosine), 0.0).rgb;
        let disc = smoothstep(cos(1.3 * SUN_RADIUS), cos(0.8 * SUN_RADIUS), dot(ray, frame.sun_direction.xyz));
        beyond = 30.0 * disc * frame.sun_top.rgb * left;
    } else {
        // Below the horizon, a dark ground at the lowest height stands in for missing terrain.
        let ground = above_ground(ray * (1e3 * air_range(frame.air.x, cosine, false).y));
        beyond = vec3<f32>(0.05, 0.055, 0.06) * light(ground.xyz, ground.xyz, 0.0) * air.w;
    }
    return vec4<f32>(tone_mapped(air.rgb + beyond), 1.0);
}
