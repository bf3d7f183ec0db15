// Restores all samples of a multisampled colour buffer from the texture that it is resolved into.

@group(0) @binding(0) var resolved: texture_2d<f32>;

@fragment
fn fs_main(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    return textureLoad(resolved, vec2<i32>(position.xy), 0);
}
