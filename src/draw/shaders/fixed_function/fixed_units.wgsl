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
    let coordinates = given_coordinates(unit, s);
    if (fixed_state.texgens[unit] & 16u) != 0u {
        return fixed_state.matrices[unit] * coordinates;
    }
    return coordinates;
}

// Returns the coordinates of the mesh, or generated ones.
fn given_coordinates(unit: u32, s: Surface) -> vec4<f32> {
    let mirrored = reflect(-towards_eye(s.in_eye), s.normal);
    switch fixed_state.texgens[unit] & 15u {
        case 1u: { return plane_coordinates(unit, s.object); }
        case 2u: { return plane_coordinates(unit, s.in_eye); }
        case 3u: {
            let m = 2.0 * length(mirrored + vec3<f32>(0.0, 0.0, 1.0));
            // Rows of an image go down.
            return vec4<f32>(vec2<f32>(mirrored.x, -mirrored.y) / max(m, 1e-6) + 0.5, 0.0, 1.0);
        }
        case 4u: { return vec4<f32>(s.normal, 1.0); }
        case 5u: { return vec4<f32>(mirrored, 1.0); }
        case 6u: { return vec4<f32>(s.other_uvs.xy, 0.0, 1.0); }
        case 7u: { return vec4<f32>(s.other_uvs.zw, 0.0, 1.0); }
        default: { return vec4<f32>(s.uv, 0.0, 1.0); }
    }
}

// Returns the colour of a unit's texture at a point; the border colour beyond edges where the sampler has none.
fn unit_color(unit: u32, s: Surface) -> vec4<f32> {
    let c = unit_coordinates(unit, s);
    let sampled = sampled_color(unit, c);
    let axes = fixed_state.borders[unit];
    if axes == 0u {
        return sampled;
    }
    let p = c.xyz / select(c.w, 1.0, c.w == 0.0);
    let is_beyond = (p < vec3<f32>(0.0)) | (p > vec3<f32>(1.0));
    let has_border = ((vec3<u32>(axes) >> vec3<u32>(0u, 1u, 2u)) & vec3<u32>(1u)) == vec3<u32>(1u);
    return select(sampled, fixed_state.border_colors[unit], any(is_beyond & has_border));
}

fn sampled_color(unit: u32, c: vec4<f32>) -> vec4<f32> {
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

// Returns an argument of a combination: 4 bits of the source, 2 of the operand.
fn argument(
    code: u32,
    unit: u32,
    constant: vec4<f32>,
    primary: vec4<f32>,
    previous: vec4<f32>,
    textures: array<vec4<f32>, 4>,
) -> vec4<f32> {
    var all = textures;
    var color = vec4<f32>(1.0);
    let source = code & 15u;
    switch source {
        case 0u: { color = all[unit]; }
        case 1u: { color = constant; }
        case 2u: { color = primary; }
        case 3u: { color = previous; }
        case 4u, 5u, 6u, 7u: { color = all[source - 4u]; }
        default: {}
    }
    switch (code >> 4u) & 3u {
        case 1u: { return vec4<f32>(1.0 - color.rgb, 1.0 - color.a); }
        case 2u: { return color.aaaa; }
        case 3u: { return 1.0 - color.aaaa; }
        default: { return color; }
    }
}

// Returns a combination of three arguments. The dot products have the same value in all components.
fn combined(code: u32, a: vec4<f32>, b: vec4<f32>, c: vec4<f32>) -> vec4<f32> {
    switch code & 15u {
        case 1u: { return a; }
        case 2u: { return a + b; }
        case 3u: { return a + b - 0.5; }
        case 4u: { return a * c + b * (1.0 - c); }
        case 5u: { return a - b; }
        case 6u, 7u: { return vec4<f32>(4.0 * dot(a.rgb - 0.5, b.rgb - 0.5)); }
        default: { return a * b; }
    }
}

// Set in the code of colours that are combined as they are displayed.
const AS_DISPLAYED: u32 = 0x80000000u;

// Returns the factor from the light of a surface to its displayed colour.
fn exposure_of(s: Surface) -> f32 {
    return select(1.0, abs(frame.shape.y), s.is_lit && frame.shape.y != 0.0);
}

// Only pipelines of states that do more than multiply textures have the code for it, which takes long to compile.
override HAS_COMBINATIONS: bool = false;

// Returns a lit colour under the drawable's own texture and the textures of all units.
fn textured(s: Surface, primary: vec4<f32>, textures: array<vec4<f32>, 4>) -> vec4<f32> {
    var all = textures;
    var color = primary * s.texel;
    for (var unit = 0u; unit < 4u; unit++) {
        let env = fixed_state.envs[unit];
        if fixed_state.units[unit] == 0u {
            continue;
        }
        // A scale of 0 stands for the plain product, which no other combination has.
        if !HAS_COMBINATIONS || (env.x == 0u && env.z == 0u) {
            color *= all[unit];
            continue;
        }
        let is_displayed = (env.x & AS_DISPLAYED) != 0u;
        let exposure = exposure_of(s);
        var constant = fixed_state.env_colors[unit];
        var lit = primary;
        var previous = color;
        var sampled = textures;
        if is_displayed {
            constant = encoded(constant, 1.0);
            lit = encoded(lit, exposure);
            previous = encoded(previous, exposure);
            for (var i = 0u; i < 4u; i++) {
                sampled[i] = encoded(sampled[i], 1.0);
            }
        }
        var arguments: array<vec4<f32>, 6>;
        for (var i = 0u; i < 3u; i++) {
            arguments[i] = argument(env.x >> (4u + 6u * i), unit, constant, lit, previous, sampled);
            arguments[3u + i] = argument(env.y >> (4u + 6u * i), unit, constant, lit, previous, sampled);
        }
        let rgb = combined(env.x, arguments[0], arguments[1], arguments[2]);
        // The alpha of a dot product is that of a product, unless the colour is a dot product with alpha.
        let code = select(env.y, 0u, (env.y & 15u) >= 6u);
        var alpha = combined(code, arguments[3], arguments[4], arguments[5]).a;
        if (env.x & 15u) == 7u {
            alpha = rgb.r;
        }
        let scaled = rgb.rgb * bitcast<f32>(env.z);
        var light = max(scaled, vec3<f32>(0.0));
        if is_displayed {
            light = decoded(scaled, exposure);
        }
        color = vec4<f32>(light, clamp(alpha * bitcast<f32>(env.w), 0.0, 1.0));
    }
    return color;
}
