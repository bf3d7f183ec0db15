// Ground coloured by rain, with a line every 100 mm. It follows the declarations of the engine that every program gets:
// `MeshVertex`, `leaves`, `frame`, `light_of_sun`. Custom attributes have locations from 4 on and are matched by name.

struct Varying {
    @builtin(position) clip: vec4<f32>,
    @location(0) in_eye: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) rain_mm: f32,
}

@vertex
fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32, @location(4) rain_mm: f32) -> Varying {
    let in_eye = point_in_eye(leaves[i], vertex.position);
    let normal = normal_in_eye(leaves[i], vertex.normal.xyz);
    return Varying(frame.clip_from_eye * vec4<f32>(in_eye, 1.0), in_eye, normal, rain_mm);
}

@fragment
fn fs_main(in: Varying) -> @location(0) vec4<f32> {
    let dry = mix(vec3<f32>(0.55, 0.42, 0.22), vec3<f32>(0.28, 0.36, 0.10), smoothstep(250.0, 600.0, in.rain_mm));
    let color = mix(dry, vec3<f32>(0.03, 0.16, 0.06), smoothstep(600.0, 1100.0, in.rain_mm));
    let hundreds = in.rain_mm / 100.0;
    let from_line = abs(fract(hundreds + 0.5) - 0.5) / fwidth(hundreds);
    let ground = above_ground(in.in_eye);
    let light = light_of_sun(normalize(in.normal), ground.xyz, ground.w) + light_of_sky(normalize(in.normal), ground.xyz);
    let lit = color * mix(0.55, 1.0, smoothstep(0.4, 1.2, from_line)) * light;
    return vec4<f32>(through_air(lit, aerial(in.in_eye)), 1.0);
}
