// The texture units of the fixed function. They are in a separate file, since states without textures bind none.

@group(2) @binding(1) var plane_0: texture_2d<f32>;
@group(2) @binding(2) var plane_0_sampler: sampler;
@group(2) @binding(3) var plane_1: texture_2d<f32>;
@group(2) @binding(4) var plane_1_sampler: sampler;
@group(2) @binding(5) var plane_2: texture_2d<f32>;
@group(2) @binding(6) var plane_2_sampler: sampler;
@group(2) @binding(7) var plane_3: texture_2d<f32>;
@group(2) @binding(8) var plane_3_sampler: sampler;
@group(2) @binding(9) var cube_map: texture_cube<f32>;
@group(2) @binding(10) var cube_map_sampler: sampler;
@group(2) @binding(11) var volume: texture_3d<f32>;
@group(2) @binding(12) var volume_sampler: sampler;
@group(2) @binding(13) var layers: texture_2d_array<f32>;
@group(2) @binding(14) var layers_sampler: sampler;

// Returns the distances of a point from the planes of a unit.
fn plane_coordinates(unit: u32, point: vec3<f32>) -> vec4<f32> {
    let p = vec4<f32>(point, 1.0);
    let first = 4u * unit;
    return vec4<f32>(
        dot(fixed_state.planes[first], p),
        dot(fixed_state.planes[first + 1u], p),
        dot(fixed_state.planes[first + 2u], p),
        dot(fixed_state.planes[first + 3u], p),
    );
}

// Returns the texture coordinates s, t, r and q of a unit.
fn unit_coordinates(unit: u32, s: Surface) -> vec4<f32> {
    let mirrored = reflect(-towards_eye(s.in_eye), s.normal);
    switch fixed_state.texgens[unit] {
        case 1u: { return plane_coordinates(unit, s.object); }
        case 2u: { return plane_coordinates(unit, s.in_eye); }
        case 3u: {
            let m = 2.0 * length(mirrored + vec3<f32>(0.0, 0.0, 1.0));
            // Rows of an image go down.
            return vec4<f32>(vec2<f32>(mirrored.x, -mirrored.y) / max(m, 1e-6) + 0.5, 0.0, 1.0);
        }
        case 4u: { return vec4<f32>(s.normal, 1.0); }
        case 5u: { return vec4<f32>(mirrored, 1.0); }
        default: { return vec4<f32>(s.uv, 0.0, 1.0); }
    }
}

// Returns the colour of a unit's texture at a point.
fn unit_color(unit: u32, s: Surface) -> vec4<f32> {
    let c = unit_coordinates(unit, s);
    // For a point in the projector's own plane the quotient is undefined.
    let p = c.xyz / select(c.w, 1.0, c.w == 0.0);
    let bias = fixed_state.bias[unit];
    switch fixed_state.units[unit] {
        case 1u: {
            switch unit {
                case 0u: { return textureSampleBias(plane_0, plane_0_sampler, p.xy, bias); }
                case 1u: { return textureSampleBias(plane_1, plane_1_sampler, p.xy, bias); }
                case 2u: { return textureSampleBias(plane_2, plane_2_sampler, p.xy, bias); }
                default: { return textureSampleBias(plane_3, plane_3_sampler, p.xy, bias); }
            }
        }
        case 2u: { return textureSampleBias(cube_map, cube_map_sampler, c.xyz, bias); }
        case 3u: { return textureSampleBias(volume, volume_sampler, p, bias); }
        case 4u: { return textureSampleBias(layers, layers_sampler, p.xy, i32(round(c.z)), bias); }
        default: { return vec4<f32>(1.0); }
    }
}
