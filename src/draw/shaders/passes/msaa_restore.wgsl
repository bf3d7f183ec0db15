// Restores all samples of a multisampled colour buffer from the texture that it is resolved into.

@group(0) @binding(0) var resolved: texture_2d<f32>;

@vertex
fn vs_restore(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fs_restore(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    return textureLoad(resolved, vec2<i32>(position.xy), 0);
}
