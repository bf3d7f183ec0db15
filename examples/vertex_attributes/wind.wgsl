// Bands of wind in moving dashes, coloured by speed.

struct Uniforms { osg_SimulationTime: f32 }
@group(2) @binding(0) var<uniform> uniforms: Uniforms;

struct Varying {
    @builtin(position) clip: vec4<f32>,
    @location(0) m_per_s: f32,
    @location(1) blown_s: f32,
}

@vertex
fn vs_main(
    vertex: MeshVertex,
    @builtin(instance_index) i: u32,
    @location(4) m_per_s: f32,
    @location(5) blown_s: f32,
) -> Varying {
    let in_eye = point_in_eye(leaves[i], vertex.position);
    return Varying(frame.clip_from_eye * vec4<f32>(in_eye, 1.0), m_per_s, blown_s);
}

@fragment
fn fs_main(in: Varying) -> @location(0) vec4<f32> {
    // A dash is as long as the wind moves in 20 of every 30 seconds; time runs 10 times as fast.
    if fract((in.blown_s - 10.0 * uniforms.osg_SimulationTime) / 30.0) > 0.67 {
        discard;
    }
    let slow = mix(vec3<f32>(0.02, 0.10, 0.60), vec3<f32>(0.75, 0.80, 0.85), smoothstep(5.0, 10.0, in.m_per_s));
    return vec4<f32>(mix(slow, vec3<f32>(0.80, 0.05, 0.02), smoothstep(10.0, 14.0, in.m_per_s)), 1.0);
}
