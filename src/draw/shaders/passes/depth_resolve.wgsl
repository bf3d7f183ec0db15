// Resolves the first sample of each pixel of a multisampled depth buffer: its depth, and its stencil bit by bit.

@group(0) @binding(0) var depths: texture_depth_multisampled_2d;
@group(0) @binding(1) var stencils: texture_multisampled_2d<u32>;

struct Pixel {
    @builtin(position) position: vec4<f32>,
    // The bit of the stencil.
    @location(0) @interpolate(flat) bit: u32,
}

@vertex
fn vs_resolve(@builtin(vertex_index) index: u32, @builtin(instance_index) bit: u32) -> Pixel {
    let corner = vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
    return Pixel(corner, bit);
}

@fragment
fn fs_depth(pixel: Pixel) -> @builtin(frag_depth) f32 {
    return textureLoad(depths, vec2<i32>(pixel.position.xy), 0);
}

// Discards pixels whose stencil lacks the bit; the others write it.
@fragment
fn fs_stencil(pixel: Pixel) {
    if (textureLoad(stencils, vec2<i32>(pixel.position.xy), 0).x >> pixel.bit & 1u) == 0u {
        discard;
    }
}
