// Lines of world coordinates. An f32 at the earth's radius has steps of half a metre. So the position of the eye comes in two
// parts; the first is reduced to the lines' period, and only then are the second and the way from the eye to the pixel added.

struct Uniforms { terrane_WorldFromEye: mat3x3<f32>, terrane_EyeHigh: vec3<f32>, terrane_EyeLow: vec3<f32> }
@group(2) @binding(0) var<uniform> uniforms: Uniforms;
struct Vertex {
    @builtin(position) clip: vec4<f32>, @location(0) in_eye: vec3<f32>, @location(1) normal: vec3<f32>,
    @location(2) color: vec3<f32>,
}
@vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> Vertex {
    let at = point_in_eye(leaves[i], vertex.position);
    let normal = normal_in_eye(leaves[i], vertex.normal.xyz);
    return Vertex(frame.clip_from_eye * vec4<f32>(at, 1.0), at, normal, leaves[i].color.rgb);
}
fn lines(period: f32, half_px: f32, from_eye: vec3<f32>) -> f32 {
    let high = uniforms.terrane_EyeHigh - period * floor(uniforms.terrane_EyeHigh / period);
    let part = fract((high + uniforms.terrane_EyeLow + from_eye) / period);
    let pixel = max(fwidth(from_eye) / period, vec3<f32>(1e-4));
    let near = half_px + 0.5 - min(part, 1.0 - part) / pixel;
    // Lines closer than a few pixels fade into their mean.
    let seen = clamp(vec3<f32>(near), vec3<f32>(0.0), vec3<f32>(1.0)) * (1.0 - smoothstep(vec3<f32>(0.1), vec3<f32>(0.5), pixel));
    return max(seen.x, max(seen.y, seen.z));
}
@fragment fn fs_main(v: Vertex) -> @location(0) vec4<f32> {
    let ground = above_ground(v.in_eye);
    let lit = light(normalize(v.normal), ground.xyz, ground.w) * v.color;
    let from_eye = uniforms.terrane_WorldFromEye * v.in_eye;
    return vec4<f32>(lit * (1.0 - 0.4 * lines(1.0, 0.5, from_eye)) * (1.0 - 0.8 * lines(10.0, 1.0, from_eye)), 1.0);
}
