// Shows a finished image on a display: maps its tones if the fragments' shaders did not, and encodes it for targets without
// an sRGB format.

@group(1) @binding(0) var finished: texture_2d<f32>;

// True for targets without sRGB format.
override ENCODES: bool = false;

@vertex
fn vs_display(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

fn encoded(linear: vec3<f32>) -> vec3<f32> {
    let low = 12.92 * linear;
    let high = 1.055 * pow(linear, vec3<f32>(1.0 / 2.4)) - 0.055;
    return select(high, low, linear <= vec3<f32>(0.0031308));
}

@fragment
fn fs_display(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    var color = max(textureLoad(finished, vec2<i32>(position.xy), 0).rgb, vec3<f32>(0.0));
    if frame.shape.y < 0.0 {
        color = compressed(color * -frame.shape.y);
    }
    if ENCODES {
        color = encoded(min(color, vec3<f32>(1.0)));
    }
    return vec4<f32>(color, 1.0);
}
