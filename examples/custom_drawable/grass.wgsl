// Waving grass. It follows the declarations of the engine: `leaves`, `point_in_eye`, `frame`, `light_of_sun`, `sun_shadow`.

@group(1) @binding(0) var<uniform> time_s: vec4<f32>;

struct Varying {
    @builtin(position) clip: vec4<f32>,
    @location(0) in_eye: vec3<f32>,
    @location(1) color: vec3<f32>,
}

fn random(seed: u32) -> f32 {
    let a = (seed ^ 61u ^ (seed >> 16u)) * 9u;
    let b = (a ^ (a >> 4u)) * 0x27d4eb2du;
    return f32((b ^ (b >> 15u)) & 0xffffffu) / 16777216.0;
}

@vertex
fn vs_grass(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> Varying {
    let blade = vertex / 3u;
    let radius = 12.0 * sqrt(random(3u * blade));
    let place = radius * vec2<f32>(cos(6.2832 * random(3u * blade + 1u)), sin(6.2832 * random(3u * blade + 1u)));
    let turn = 6.2832 * random(3u * blade + 2u);
    var point = vec3<f32>(place + 0.03 * (f32(vertex % 3u) - 1.0) * vec2<f32>(cos(turn), sin(turn)), 0.0);
    let tip = vertex % 3u == 1u;
    if tip {
        let wind = sin(0.7 * place.x + 0.4 * place.y - 2.0 * time_s.x) + 0.3 * sin(3.1 * place.x - 5.0 * time_s.x);
        point += vec3<f32>(0.25 * wind, 0.1 * wind, 0.35 + 0.5 * random(blade) - 0.06 * wind * wind);
    }
    let in_eye = point_in_eye(leaves[instance], point);
    let color = mix(vec3<f32>(0.05, 0.12, 0.02), vec3<f32>(0.35, 0.55, 0.12), select(0.0, 1.0, tip));
    return Varying(frame.clip_from_eye * vec4<f32>(in_eye, 1.0), in_eye, color * leaves[instance].color.rgb);
}

@fragment
fn fs_grass(in: Varying) -> @location(0) vec4<f32> {
    let ground = above_ground(in.in_eye);
    let sun = light_of_sun(ground.xyz, ground.xyz, ground.w) * sun_shadow(in.in_eye, ground.xyz);
    let lit = in.color * (sun + light_of_sky(ground.xyz, ground.xyz));
    return vec4<f32>(through_air(lit, aerial(in.in_eye)), 1.0);
}
