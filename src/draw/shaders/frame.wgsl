// Shared by all pipelines: what is known per frame and per leaf, light and haze.

struct Frame {
    clip_from_eye: mat4x4<f32>,
    sun_direction: vec4<f32>,  // in eye space; w: metres of range per metre of geometric error
    sun_color: vec4<f32>,      // linear; w: share of a range where morphing starts
    ambient_color: vec4<f32>,  // linear; w: fog density per metre at height 0
    up: vec4<f32>,             // in eye space, at the eye; w: height of the eye, metres
    horizon_color: vec4<f32>,  // linear; w: 1 / height over which air thins to 1/e
    zenith_color: vec4<f32>,   // linear; w: 1 / radius of the ground, 0 when flat
    ray: vec4<f32>,            // eye ray from clip position: scale xy, offset zw
    horizon: vec4<f32>,        // sine of the horizon's dip, share of air at the eye, sine over which the sky's haze thins;
                               // w: exposure, 0 without tone mapping
    water: vec4<f32>,          // linear colour of deep water; w: its height, metres
}

struct Leaf {
    eye_from_drawable_x: vec4<f32>,
    eye_from_drawable_y: vec4<f32>,
    eye_from_drawable_z: vec4<f32>,
    color: vec4<f32>,  // linear factor
    layer: u32,
    flags: u32,
    alpha_cutoff: u32,  // bits of an f32; first vertex of pulled meshes
    side: u32,          // of height tiles; first index of pulled meshes
}

// What is positioned in a stage, in eye space.
struct StageLight {
    position: vec4<f32>,     // w: 1 for a place, 0 for a direction
    direction: vec4<f32>,    // of a spot; w: cosine of its half angle
    ambient: vec4<f32>,      // w: exponent of the spot
    diffuse: vec4<f32>,      // w: 1 where there is such a light
    specular: vec4<f32>,
    attenuation: vec4<f32>,  // constant, linear, quadratic
}

struct Stage {
    lights: array<StageLight, 8>,
    clip_planes: array<vec4<f32>, 6>,
}

const FLAG_UNLIT: u32 = 1u;
const FLAG_UNTEXTURED: u32 = 2u;
const INDEX_COUNT_SHIFT: u32 = 8u;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> leaves: array<Leaf>;
@group(0) @binding(2) var<uniform> stage: Stage;

// What a drawable's texture gives; where textures are switched off, its alpha alone.
fn texel(sampled: vec4<f32>, flags: u32) -> vec4<f32> {
    return select(sampled, vec4<f32>(1.0, 1.0, 1.0, sampled.a), (flags & FLAG_UNTEXTURED) != 0u);
}

fn point_in_eye(leaf: Leaf, point: vec3<f32>) -> vec3<f32> {
    let p = vec4<f32>(point, 1.0);
    return vec3<f32>(
        dot(leaf.eye_from_drawable_x, p),
        dot(leaf.eye_from_drawable_y, p),
        dot(leaf.eye_from_drawable_z, p),
    );
}

fn direction_in_eye(leaf: Leaf, direction: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot(leaf.eye_from_drawable_x.xyz, direction),
        dot(leaf.eye_from_drawable_y.xyz, direction),
        dot(leaf.eye_from_drawable_z.xyz, direction),
    );
}

// Sun and sky on a surface; `up` is the direction away from the ground there.
fn light(normal: vec3<f32>, up: vec3<f32>) -> vec3<f32> {
    let sun = max(dot(normal, frame.sun_direction.xyz), 0.0);
    // A sun below the local horizon (the night side of a globe) shines on nothing.
    let day = clamp(dot(up, frame.sun_direction.xyz) * 5.0 + 0.5, 0.0, 1.0);
    let ground = frame.ambient_color.rgb * vec3<f32>(0.45, 0.40, 0.34);
    let ambient = mix(ground, frame.ambient_color.rgb, 0.5 + 0.5 * dot(normal, up));
    return frame.sun_color.rgb * sun * day + ambient * (0.15 + 0.85 * day);
}

// Lit colours for a display: times the exposure, highlights rolled off towards white, what is below 0.76 as it is.
// Khronos PBR Neutral (https://github.com/KhronosGroup/ToneMapping) without its offset, which takes back a reflection
// at normal incidence that there is not here.
fn tone_mapped(lit_color: vec3<f32>) -> vec3<f32> {
    if frame.horizon.w <= 0.0 {
        return lit_color;
    }
    let start = 0.8 - 0.04;
    var color = lit_color * frame.horizon.w;
    let peak = max(color.r, max(color.g, color.b));
    if peak < start {
        return color;
    }
    let room = 1.0 - start;
    let new_peak = 1.0 - room * room / (peak + room - start);
    color *= new_peak / peak;
    let share = 1.0 - 1.0 / (0.15 * (peak - new_peak) + 1.0);
    return mix(color, vec3<f32>(new_peak), share);
}

// Share of a point's colour that haze takes, from the mean density of air along the way to it.
fn haze(point: vec3<f32>) -> f32 {
    if frame.ambient_color.w <= 0.0 {
        return 0.0;
    }
    let distance = length(point);
    let rise = dot(point, frame.up.xyz);
    let across2 = max(distance * distance - rise * rise, 0.0);
    let eye_height = frame.up.w * frame.horizon_color.w;
    var height = frame.up.w + rise;
    if frame.zenith_color.w > 0.0 {
        let radius = 1.0 / frame.zenith_color.w;
        let from_center = radius + height;
        height = sqrt(from_center * from_center + across2) - radius;
    }
    let point_height = max(height, 0.0) * frame.horizon_color.w;
    let climb = point_height - eye_height;
    var density = exp(-0.5 * (point_height + eye_height));
    if abs(climb) > 1e-2 {
        density = (exp(-eye_height) - exp(-point_height)) / climb;
    }
    return 1.0 - exp(-frame.ambient_color.w * distance * density);
}
