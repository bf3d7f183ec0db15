// Composes the images of two eyes into one.

@group(0) @binding(0) var left: texture_2d<f32>;
@group(0) @binding(1) var right: texture_2d<f32>;
// The stereo mode, the pixels between the halves, and the origin of the viewport in the target.
@group(0) @binding(2) var<uniform> mode: vec4<u32>;

@vertex
fn vs_composite(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fs_composite(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    // Interlaced rows and columns are counted from the target's origin.
    let on_screen = vec2<i32>(position.xy);
    let pixel = on_screen - vec2<i32>(mode.zw);
    let size = vec2<i32>(textureDimensions(left));
    let inside = min(pixel, size - 1);
    let gap = i32(mode.y);
    var is_right = false;
    var is_between = false;
    var at = inside;
    switch mode.x {
        case 0u: {
            let r = textureLoad(left, inside, 0).r;
            return vec4<f32>(r, textureLoad(right, inside, 0).gb, 1.0);
        }
        // Two halves: columns or rows from the left eye's size plus the gap on belong to the right eye.
        case 1u: {
            is_right = pixel.x >= size.x + gap;
            is_between = pixel.x >= size.x && !is_right;
            at = vec2<i32>(min(select(pixel.x, pixel.x - size.x - gap, is_right), size.x - 1), inside.y);
        }
        case 2u: {
            is_right = pixel.y >= size.y + gap;
            is_between = pixel.y >= size.y && !is_right;
            at = vec2<i32>(inside.x, min(select(pixel.y, pixel.y - size.y - gap, is_right), size.y - 1));
        }
        case 3u: {}
        case 4u: { is_right = true; }
        case 5u: { is_right = (on_screen.y & 1) == 1; }
        case 6u: { is_right = (on_screen.x & 1) == 1; }
        default: { is_right = ((on_screen.x + on_screen.y) & 1) == 1; }
    }
    if is_between {
        return vec4<f32>(0.0, 0.0, 0.0, 1.0);
    }
    if is_right {
        return vec4<f32>(textureLoad(right, at, 0).rgb, 1.0);
    }
    return vec4<f32>(textureLoad(left, at, 0).rgb, 1.0);
}
