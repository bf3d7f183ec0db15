// The fixed function without texture units.

fn unit_color(unit: u32, s: Surface) -> vec4<f32> {
    return vec4<f32>(1.0);
}

// Returns a lit colour under the drawable's own texture.
fn textured(s: Surface, primary: vec4<f32>, textures: array<vec4<f32>, 4>) -> vec4<f32> {
    return primary * s.texel;
}
