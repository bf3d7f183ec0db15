// The background of a stage that draws into a part of a target: one triangle over its viewport, in a leaf's colour.

struct FillVertex {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) color: vec4<f32>,
}

@vertex
fn vs_fill(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> FillVertex {
    let xy = vec2<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0);
    // Reversed-Z: depth 0 is infinitely far.
    return FillVertex(vec4<f32>(xy, 0.0, 1.0), leaves[instance].color);
}

// The same colour for all attachments; locations without an attachment are ignored.
struct FillColors {
    @location(0) color_0: vec4<f32>,
    @location(1) color_1: vec4<f32>,
    @location(2) color_2: vec4<f32>,
    @location(3) color_3: vec4<f32>,
    @location(4) color_4: vec4<f32>,
    @location(5) color_5: vec4<f32>,
    @location(6) color_6: vec4<f32>,
    @location(7) color_7: vec4<f32>,
}

@fragment
fn fs_fill(in: FillVertex) -> FillColors {
    let c = in.color;
    return FillColors(c, c, c, c, c, c, c, c);
}
