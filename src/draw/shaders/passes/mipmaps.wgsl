// A mip level from the one above: each texel is the mean of four.

@group(0) @binding(0) var above: texture_2d<f32>;

@fragment
fn fs_main(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let first = 2u * vec2<u32>(at.xy);
    let last = textureDimensions(above) - 1u;
    var sum = vec4<f32>(0.0);
    for (var i = 0u; i < 4u; i++) {
        sum += textureLoad(above, min(first + vec2<u32>(i & 1u, i >> 1u), last), 0);
    }
    return 0.25 * sum;
}
