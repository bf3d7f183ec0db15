// The fixed function without texture units.

fn unit_color(unit: u32, s: Surface) -> vec4<f32> {
    return vec4<f32>(1.0);
}
