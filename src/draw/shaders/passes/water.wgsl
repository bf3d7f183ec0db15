// A water surface at one height around the whole globe, found at each pixel by intersecting its ray.

struct WaterFragment {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

// Returns the light from a direction of eye space: the sky's, or the horizon's colour without an atmosphere.
fn mirrored_light(ray: vec3<f32>) -> vec3<f32> {
    if frame.shape.z <= 0.0 {
        return frame.horizon_color.rgb;
    }
    return sky_color(ray);
}

@fragment
fn fs_water(in: SkyVertex) -> WaterFragment {
    let of_pixel = ray_of(in.ray);
    let origin = of_pixel.origin;
    let ray = of_pixel.direction;
    let down = -dot(ray, frame.up.xyz);
    let rise = dot(origin, frame.up.xyz);
    var above = frame.up.w + rise - frame.water.w;
    var distance = above / down;
    var normal = frame.up.xyz;
    if frame.shape.x > 0.0 {
        // The ray meets the sphere of the water at t^2 - 2 b t + c = 0, in terms of differences to avoid rounding errors.
        let radius = 1.0 / frame.shape.x;
        let b = down * (radius + frame.up.w) - dot(origin, ray);
        let c = dot(origin, origin) + 2.0 * rise * (radius + frame.up.w)
            + (frame.up.w - frame.water.w) * (2.0 * radius + frame.up.w + frame.water.w);
        let inside = b * b - c;
        if inside < 0.0 {
            discard;
        }
        above = c * frame.shape.x;
        distance = c / (b + sqrt(inside));
        normal = normalize(origin + ray * distance + frame.up.xyz * (radius + frame.up.w));
    }
    // Rays above the horizon, or from below the water, meet none. Parallel rays start behind the eye.
    if !(down > 0.0 && (frame.air.w > 0.0 || distance > 0.0 && above > 0.0)) {
        discard;
    }
    let point = origin + ray * distance;
    let clip = frame.clip_from_eye * vec4<f32>(point, 1.0);
    if frame.air.w > 0.0 && (clip.z < 0.0 || clip.z > clip.w) {
        discard;
    }

    let facing = max(-dot(ray, normal), 0.0);
    let fresnel = 0.02 + 0.98 * pow(1.0 - facing, 5.0);
    let mirrored = reflect(ray, normal);
    let half_way = normalize(frame.sun_direction.xyz - ray);
    // Waves smaller than a pixel spread the sun's reflection by a lobe of their slopes.
    let glitter = 6.0 * pow(max(dot(normal, half_way), 0.0), 400.0) * step(0.0, dot(normal, frame.sun_direction.xyz));
    let lit = sun_shadow(point, normal);
    let deep = frame.water.rgb * (light_of_sun(normal, normal, frame.water.w) * lit + light_of_sky(normal, normal));
    let sun = light_of_sun(frame.sun_direction.xyz, normal, frame.water.w);
    let reflected = mirrored_light(mirrored) + sun * (lit * glitter);
    let color = mix(deep, reflected, fresnel);
    let opacity = mix(0.88, 1.0, fresnel);
    return WaterFragment(
        vec4<f32>(through_air(color, aerial(point)), opacity),
        clamp(clip.z / clip.w, 0.0, 1.0),
    );
}
