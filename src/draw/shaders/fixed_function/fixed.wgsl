// The fixed function: lights, material, fog, clip planes, alpha test and texture units, in OpenGL's terms.

// The material of one side of a surface.
struct Reflection {
    ambient: vec4<f32>,
    diffuse: vec4<f32>,
    specular: vec4<f32>,       // w: shininess
    emission: vec4<f32>,
}

// The uniforms of a state.
struct Fixed {
    front: Reflection,
    back: Reflection,
    fog_color: vec4<f32>,      // w: 0 none, 1 the environment's haze, 2 linear, 3 exp, 4 exp2
    fog: vec4<f32>,            // of linear fog, end and 1 / (end - start); otherwise the density per metre. z: 1 if colours
                               // are mixed as they are displayed
    model_ambient: vec4<f32>,  // w: reference of the alpha test
    model: vec4<u32>,          // 1 for a local viewer; the lit side (below); 1 if highlights are added after textures
    flags: vec4<u32>,          // bits of lights, bits of clip planes, alpha test, 1 if a light replaces the sun
    units: vec4<u32>,          // 0 off, 1 plane, 2 cube, 3 volume, 4 array
    texgens: vec4<u32>,        // 0 the mesh's coordinates, 1 object linear, 2 eye linear, 3 sphere, 4 normal, 5 reflection,
                               // 6 the second and 7 the third ones of the mesh; 16 more if a matrix follows
    bias: vec4<f32>,           // added to the mip level
    planes: array<vec4<f32>, 16>,      // of s, t, r and q, by unit
    envs: array<vec4<u32>, 4>,         // by unit: combination of colour and of alpha, bits of the two scales; 0 multiplies
    env_colors: array<vec4<f32>, 4>,   // constant colour by unit
    matrices: array<mat4x4<f32>, 4>,   // of coordinates, by unit
    borders: vec4<u32>,                // axes, as bits, beyond whose edges is the border colour
    border_colors: array<vec4<f32>, 4>,
}

@group(2) @binding(0) var<uniform> fixed_state: Fixed;

// The lit side: without a light model (0), the visible one; with a one-sided model, the front; with a two-sided one, both.
const FRONT_ONLY: u32 = 1u;
const BOTH_SIDES: u32 = 2u;

// Returns true if the back of a surface is lit.
fn is_back(is_front: bool) -> bool {
    return fixed_state.model.y == BOTH_SIDES && !is_front;
}

// A point to be shaded. All vectors but `object` and texture coordinates are in eye space.
struct Surface {
    in_eye: vec3<f32>,
    normal: vec3<f32>,
    facing: vec3<f32>,  // the normal for the look-up of shadows
    up: vec3<f32>,
    object: vec3<f32>,
    uv: vec2<f32>,
    other_uvs: vec4<f32>,  // the second and the third texture coordinates
    texel: vec4<f32>,   // of the drawable's own texture
    color: vec4<f32>,
    is_lit: bool,
    is_back: bool,
    alpha_cutoff: f32,
}

// Returns the direction to the eye; the axis if rays are parallel, and for a point at the eye itself.
fn towards_eye(in_eye: vec3<f32>) -> vec3<f32> {
    let square = dot(in_eye, in_eye);
    let is_along = frame.air.w > 0.0 || square <= 0.0;
    return select(-in_eye * inverseSqrt(square), vec3<f32>(0.0, 0.0, 1.0), is_along);
}

// The light that a surface reflects, before textures: highlights, and the rest.
struct Reflected {
    color: vec3<f32>,
    highlights: vec3<f32>,
}

// Returns the light of all lights that a surface of a base colour reflects.
fn lit(s: Surface, base: vec3<f32>) -> Reflected {
    var side = fixed_state.front;
    if s.is_back {
        side = fixed_state.back;
    }
    let ambient = base * side.ambient.rgb;
    let diffuse = base * side.diffuse.rgb;
    var color = side.emission.rgb + fixed_state.model_ambient.rgb * ambient;
    var highlights = vec3<f32>(0.0);
    let to_eye = select(vec3<f32>(0.0, 0.0, 1.0), towards_eye(s.in_eye), fixed_state.model.x == 1u);
    if (fixed_state.flags.x & 1u) != 0u && fixed_state.flags.w == 0u {
        let to_sun = frame.sun_direction.xyz;
        let height_m = above_ground(s.in_eye).w;
        var sun = light_of_sun(s.normal, s.up, height_m);
        if dot(s.normal, to_sun) > 0.0 {
            let visible = sun_shadow(s.in_eye, s.facing);
            sun *= visible;
            if side.specular.w > 0.0 {
                let half_way = normalize(to_sun + to_eye);
                let shine = pow(max(dot(s.normal, half_way), 0.0), side.specular.w);
                highlights += visible * shine * light_of_sun(to_sun, s.up, height_m) * side.specular.rgb;
            }
        }
        color += diffuse * (sun + light_of_sky(s.normal, s.up));
    }
    for (var i = 0u; i < stage.light_count.x; i++) {
        let l = stage.lights[i];
        if (i < STAGE_LIGHTS && (fixed_state.flags.x >> i & 1u) == 0u) || l.diffuse.w < 0.5 {
            continue;
        }
        let way = way_to_light(l, s.in_eye);
        let to_light = way.xyz;
        let facing = max(dot(s.normal, to_light), 0.0);
        color += way.w * (l.ambient.rgb * ambient + facing * l.diffuse.rgb * diffuse);
        if facing > 0.0 && side.specular.w > 0.0 {
            let half_way = normalize(to_light + to_eye);
            let shine = pow(max(dot(s.normal, half_way), 0.0), side.specular.w);
            highlights += way.w * shine * l.specular.rgb * side.specular.rgb;
        }
    }
    return Reflected(color, highlights);
}

// Returns a colour as it is displayed (sRGB) under an exposure, from 0 to 1.
fn encoded(color: vec4<f32>, exposure: f32) -> vec4<f32> {
    let c = clamp(color.rgb * exposure, vec3<f32>(0.0), vec3<f32>(1.0));
    let high = 1.055 * pow(c, vec3<f32>(1.0 / 2.4)) - 0.055;
    return vec4<f32>(select(high, 12.92 * c, c <= vec3<f32>(0.0031308)), color.a);
}

// The inverse of `encoded`.
fn decoded(color: vec3<f32>, exposure: f32) -> vec3<f32> {
    let c = clamp(color, vec3<f32>(0.0), vec3<f32>(1.0));
    let high = pow((c + 0.055) / 1.055, vec3<f32>(2.4));
    return select(high, c / 12.92, c <= vec3<f32>(0.04045)) / exposure;
}

// Returns a colour as seen through fog or haze, tone mapped if it is lit.
fn fogged(s: Surface, color: vec3<f32>) -> vec3<f32> {
    let distance = -s.in_eye.z;
    var share = 0.0;
    switch u32(fixed_state.fog_color.w) {
        case 1u: {
            let air = aerial(s.in_eye);
            if s.is_lit {
                return through_air(color, air);
            }
            return unlit_through_air(color, air);
        }
        case 2u: { share = 1.0 - (fixed_state.fog.x - distance) * fixed_state.fog.y; }
        case 3u: { share = 1.0 - exp(-fixed_state.fog.x * distance); }
        case 4u: {
            let thickness = fixed_state.fog.x * distance;
            share = 1.0 - exp(-thickness * thickness);
        }
        default: {}
    }
    var shown = displayed(color);
    if s.is_lit {
        shown = tone_mapped(color);
    }
    let fog = displayed(fixed_state.fog_color.rgb);
    share = clamp(share, 0.0, 1.0);
    if fixed_state.fog.z == 0.0 {
        return mix(shown, fog, share);
    }
    // A later pass may apply an exposure.
    let exposure = select(1.0, -frame.shape.y, frame.shape.y < 0.0);
    let mixed = mix(encoded(vec4<f32>(shown, 1.0), exposure), encoded(vec4<f32>(fog, 1.0), exposure), share);
    return decoded(mixed.rgb, exposure);
}

fn passes_alpha_test(alpha: f32) -> bool {
    let reference = fixed_state.model_ambient.w;
    switch fixed_state.flags.z {
        case 0u: { return false; }
        case 1u: { return alpha < reference; }
        case 2u: { return alpha == reference; }
        case 3u: { return alpha <= reference; }
        case 4u: { return alpha > reference; }
        case 5u: { return alpha != reference; }
        case 6u: { return alpha >= reference; }
        default: { return true; }
    }
}

fn is_clipped(in_eye: vec3<f32>) -> bool {
    for (var i = 0u; i < 6u; i++) {
        let plane = stage.clip_planes[i];
        if (fixed_state.flags.y >> i & 1u) != 0u && dot(plane.xyz, in_eye) + plane.w < 0.0 {
            return true;
        }
    }
    return false;
}

// The textures of all units at a point. They are sampled before any discard, since mip levels need the neighbouring pixels.
fn all_textures(s: Surface) -> array<vec4<f32>, 4> {
    return array<vec4<f32>, 4>(unit_color(0u, s), unit_color(1u, s), unit_color(2u, s), unit_color(3u, s));
}

// Returns the colour of a surface before lighting and textures.
fn primary_color(s: Surface) -> vec4<f32> {
    var color = s.color;
    color.a *= select(fixed_state.front.diffuse.a, fixed_state.back.diffuse.a, s.is_back);
    return color;
}

// Returns true if clip planes, the alpha mask or the alpha test discard a fragment.
fn is_dropped(s: Surface, base: vec4<f32>) -> bool {
    return is_clipped(s.in_eye) || base.a < s.alpha_cutoff || !passes_alpha_test(base.a);
}

// Returns true where a caster has a hole and casts no shadow.
fn is_hole(s: Surface) -> bool {
    return is_dropped(s, textured(s, primary_color(s), all_textures(s)));
}

fn fixed_color(s: Surface) -> vec4<f32> {
    let textures = all_textures(s);
    var primary = primary_color(s);
    // Highlights that are added after the textures.
    var separate = vec3<f32>(0.0);
    if s.is_lit {
        let reflected = lit(s, primary.rgb);
        let is_separate = fixed_state.model.z == 1u;
        separate = select(vec3<f32>(0.0), reflected.highlights, is_separate);
        primary = vec4<f32>(reflected.color + reflected.highlights - separate, primary.a);
    }
    let color = textured(s, primary, textures);
    if is_dropped(s, color) {
        discard;
    }
    return vec4<f32>(fogged(s, color.rgb + separate), color.a);
}
