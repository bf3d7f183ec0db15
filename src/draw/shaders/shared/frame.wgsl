// Shared by all pipelines: the uniforms of frame and stage, the leaves, light, air and haze.

// The uniforms of a view. Colours are linear.
struct Frame {
    clip_from_eye: mat4x4<f32>,
    sun_direction: vec4<f32>,  // in eye space; w: metres of range per metre of geometric error
    sun_color: vec4<f32>,      // w: share of a range at which morphing starts
    ambient_color: vec4<f32>,  // w: fog density per metre at height 0
    up: vec4<f32>,             // in eye space, at the eye; w: height of the eye, metres
    horizon_color: vec4<f32>,  // w: 1 / height over which the density of air falls to 1/e, metres
    shape: vec4<f32>,          // 1 / radius of the ground, 0 if flat; exposure, 0 without tone mapping, negative if a later
                               // pass maps tones; 1 with an atmosphere; 1 if it is also drawn in front of things
    ray: vec4<f32>,            // columns of the map from clip position to eye-space ray: xy and zw
    middle_ray: vec4<f32>,     // xy: the ray of clip position 0; zw: size of a pixel in clip positions
    water: vec4<f32>,          // colour of deep water; w: its height, metres
    air: vec4<f32>,            // the eye of the air tables: kilometres from the earth's centre, cosines of horizon and limb
                               // (air.wgsl); w: 1 if rays are parallel
    sun_top: vec4<f32>,        // irradiance of the sun outside the air; w: layer of the first cascade's shadow map
    night: vec4<f32>,          // x: share of the ambient light that remains at night
    shadow_x: vec4<f32>,       // in eye space, across the sun's rays; w: how far points are moved along normals, texels
    shadow_y: vec4<f32>,       // the other axis; w: how far points are moved towards the sun, texels
    shadow: vec4<f32>,         // number of cascades; 1 / texels a side; depths between which shadows fade out, metres
    cascade_scales: array<vec4<f32>, 4>,   // scales from metres to the map, across and along the rays; depths of its end and
                                           // of the start of the next cascade
    cascade_offsets: array<vec4<f32>, 4>,  // position of the eye in the map; w: width of a texel, metres
}

// A drawable in a view: the instances of a draw.
struct Leaf {
    eye_from_drawable_x: vec4<f32>,
    eye_from_drawable_y: vec4<f32>,
    eye_from_drawable_z: vec4<f32>,
    color: vec4<f32>,  // linear factor
    layer: u32,  // or the record of a surface
    flags: u32,
    alpha_cutoff: u32,  // bits of an f32; first vertex of pulled meshes
    side: u32,          // vertices along a side of height tiles; first index of pulled meshes; degree of the harmonics of splats
}

// A light of a stage, in eye space.
struct StageLight {
    position: vec4<f32>,     // w: 1 for a position, 0 for a direction
    direction: vec4<f32>,    // axis of a spot; w: cosine of its half angle, -1 without a spot
    ambient: vec4<f32>,      // w: exponent of the spot
    diffuse: vec4<f32>,      // w: 1 if the light exists
    specular: vec4<f32>,     // w: cosine of the half angle inside of which a spot has its full strength
    attenuation: vec4<f32>,  // constant, linear, quadratic; w: 1 / range, 0 without a range
}

// The lights and clip planes of a stage.
struct Stage {
    lights: array<StageLight, 24>,  // those of state sets by number, from STAGE_LIGHTS on local ones
    clip_planes: array<vec4<f32>, 6>,
    light_count: vec4<u32>,         // x: the end of the local lights; y: 1 if the volume is a sphere
    volume: array<vec4<f32>, 3>,    // that some leaves are cut to: the map from eye space to the unit cube or sphere, by rows
}

// Pipelines of frames without atmosphere or haze leave their code out, since software adapters run both sides of a branch.
override HAS_ATMOSPHERE: bool = true;
override HAS_HAZE: bool = true;
// Only pipelines of leaves that local lights shine on have the code for them.
override HAS_LOCAL_LIGHTS: bool = false;

const STAGE_LIGHTS: u32 = 8u;

const FLAG_UNLIT: u32 = 1u;
const FLAG_UNTEXTURED: u32 = 2u;
const INDEX_COUNT_SHIFT: u32 = 8u;
const BAND_SHIFT: u32 = 16u;
const BAND_OF_VOLUME: u32 = 255u;
const BAND_OF_BACKDROP: u32 = 511u;
// The share of its depth value that a backdrop keeps: it stays in front of the cleared depth and behind all else, and its
// own parts keep their order.
const BACKDROP_DEPTH: f32 = 1e-6;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> leaves: array<Leaf>;
@group(0) @binding(2) var<uniform> stage: Stage;
@group(0) @binding(3) var air_sampler: sampler;
@group(0) @binding(4) var sunlight: texture_2d<f32>;
@group(0) @binding(5) var sky_light: texture_2d<f32>;
@group(0) @binding(6) var air_scattered: texture_3d<f32>;
@group(0) @binding(7) var air_mie: texture_3d<f32>;

// Returns a sample of a drawable's texture; only its alpha if textures are switched off.
fn texel(sampled: vec4<f32>, flags: u32) -> vec4<f32> {
    return select(sampled, vec4<f32>(1.0, 1.0, 1.0, sampled.a), (flags & FLAG_UNTEXTURED) != 0u);
}

// Returns true for the pixels that a fading leaf does not draw: interleaved gradient noise (J. Jimenez, Next
// Generation Post Processing in Call of Duty: Advanced Warfare, 2014) as a number from 0 to 254, the same in every frame.
fn is_faded_out(pixel: vec2<f32>, flags: u32) -> bool {
    let noise = fract(52.9829189 * fract(dot(floor(pixel), vec2<f32>(0.06711056, 0.00583715))));
    let value = min(u32(noise * 255.0), 254u);
    return value < (flags >> BAND_SHIFT & 255u) || value >= flags >> (BAND_SHIFT + 8u);
}

// Returns true for the points of a leaf that are not drawn: those outside of the volume that it is cut to, or the pixels that
// a fade leaves out.
fn is_left_out(pixel: vec2<f32>, in_eye: vec3<f32>, flags: u32) -> bool {
    if (flags >> BAND_SHIFT & 255u) != BAND_OF_VOLUME {
        return is_faded_out(pixel, flags);
    }
    let p = vec4<f32>(in_eye, 1.0);
    let at = vec3<f32>(dot(stage.volume[0], p), dot(stage.volume[1], p), dot(stage.volume[2], p));
    let farthest = max(max(abs(at.x), abs(at.y)), abs(at.z));
    return select(farthest, length(at), stage.light_count.y != 0u) > 1.0;
}

// Transforms a point of a leaf to eye space.
fn point_in_eye(leaf: Leaf, point: vec3<f32>) -> vec3<f32> {
    let p = vec4<f32>(point, 1.0);
    return vec3<f32>(
        dot(leaf.eye_from_drawable_x, p),
        dot(leaf.eye_from_drawable_y, p),
        dot(leaf.eye_from_drawable_z, p),
    );
}

// Returns the clip position of a vertex of a leaf. Software adapters run the shader for several vertices at once, and fill
// missing ones with leaves of zeros. Those are put inside the clip volume, since otherwise all the vertices are clipped,
// which is slow.
fn clip_of(leaf: Leaf, in_eye: vec3<f32>) -> vec4<f32> {
    var clip = frame.clip_from_eye * vec4<f32>(in_eye, 1.0);
    clip.z *= select(1.0, BACKDROP_DEPTH, leaf.flags >> BAND_SHIFT == BAND_OF_BACKDROP);
    let is_there = any(leaf.eye_from_drawable_x.xyz != vec3<f32>(0.0));
    return select(vec4<f32>(0.0, 0.0, 0.0, 1.0), clip, is_there);
}

// Transforms a direction of a leaf to eye space.
fn direction_in_eye(leaf: Leaf, direction: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot(leaf.eye_from_drawable_x.xyz, direction),
        dot(leaf.eye_from_drawable_y.xyz, direction),
        dot(leaf.eye_from_drawable_z.xyz, direction),
    );
}

// Transforms a normal of a leaf to eye space and to length 1; zero stays zero. The matrix is that of the cofactors: with
// unequal scales, normals turn otherwise than directions, and a mirroring transform must not turn surfaces inside out.
fn normal_in_eye(leaf: Leaf, normal: vec3<f32>) -> vec3<f32> {
    let x = leaf.eye_from_drawable_x.xyz;
    let y = leaf.eye_from_drawable_y.xyz;
    let z = leaf.eye_from_drawable_z.xyz;
    let yz = cross(y, z);
    let turned = vec3<f32>(dot(yz, normal), dot(cross(z, x), normal), dot(cross(x, y), normal));
    let square = dot(turned, turned);
    let outwards = select(turned, -turned, dot(x, yz) < 0.0);
    return select(vec3<f32>(0.0), outwards * inverseSqrt(square), square > 0.0);
}

// Returns the direction away from the ground at a point in eye space, and the point's height in metres.
fn above_ground(point: vec3<f32>) -> vec4<f32> {
    let rise = dot(point, frame.up.xyz);
    let height = frame.up.w + rise;
    if frame.shape.x <= 0.0 {
        return vec4<f32>(frame.up.xyz, height);
    }
    let across = point - rise * frame.up.xyz;
    let radius = 1.0 / frame.shape.x;
    let from_center = sqrt((radius + height) * (radius + height) + dot(across, across));
    // The difference of two large numbers without their rounding errors.
    let over = dot(across, across) / (from_center + radius + height);
    return vec4<f32>(((radius + height) * frame.up.xyz + across) / from_center, height + over);
}

// Returns the sun's irradiance at a height on a surface that faces it.
fn sun_at(up: vec3<f32>, height_m: f32) -> vec3<f32> {
    let height = height_m * 1e-3;
    let cosine = dot(up, frame.sun_direction.xyz);
    let left = textureSampleLevel(sunlight, air_sampler, sunlight_place(height, cosine), 0.0).rgb;
    return frame.sun_top.rgb * left * sun_share(height, cosine);
}

// Returns the irradiance of sun and sky on a surface over pi; `up` is the direction away from the ground there.
fn light(normal: vec3<f32>, up: vec3<f32>, height_m: f32) -> vec3<f32> {
    return light_of_sun(normal, up, height_m) + light_of_sky(normal, up);
}

// Returns the sun's part of `light`, without shadows.
fn light_of_sun(normal: vec3<f32>, up: vec3<f32>, height_m: f32) -> vec3<f32> {
    let facing = max(dot(normal, frame.sun_direction.xyz), 0.0);
    if !HAS_ATMOSPHERE || frame.shape.z <= 0.0 {
        return frame.sun_color.rgb * facing * sun_daylight(dot(up, frame.sun_direction.xyz));
    }
    return sun_at(up, height_m) * (facing / 3.14159265);
}

// Returns the share of sunlight by the sun's elevation: none on the night side of a globe, without an atmosphere.
fn sun_daylight(cosine: f32) -> f32 {
    return clamp(cosine * 5.0 + 0.5, 0.0, 1.0);
}

// Returns the sky's part of `light`.
fn light_of_sky(normal: vec3<f32>, up: vec3<f32>) -> vec3<f32> {
    let cosine = dot(up, frame.sun_direction.xyz);
    let ground = frame.ambient_color.rgb * vec3<f32>(0.45, 0.40, 0.34);
    let ambient = mix(ground, frame.ambient_color.rgb, 0.5 + 0.5 * dot(normal, up));
    if !HAS_ATMOSPHERE || frame.shape.z <= 0.0 {
        return ambient * max(0.15 + 0.85 * sun_daylight(cosine), frame.night.x);
    }
    // The ambient light is that of a high sun. It falls with the sky's light, and some remains at night.
    let place = vec2<f32>(sky_light_place(cosine), 0.5);
    let sky = textureSampleLevel(sky_light, air_sampler, place, 0.0).rgb;
    return ambient * max(sky, vec3<f32>(frame.night.x));
}

// Returns the direction to a light from a point in eye space, and the share of the light that arrives there.
fn way_to_light(light: StageLight, in_eye: vec3<f32>) -> vec4<f32> {
    var to_light = light.position.xyz;
    var strength = 1.0;
    if light.position.w > 0.5 {
        to_light -= in_eye;
        let d = length(to_light);
        strength = 1.0 / max(light.attenuation.x + d * (light.attenuation.y + d * light.attenuation.z), 1e-6);
        let part = d * light.attenuation.w;
        strength *= clamp(1.0 - part * part * part * part, 0.0, 1.0);
    }
    to_light = normalize(to_light);
    if light.direction.w > -1.0 {
        let cosine = dot(-to_light, light.direction.xyz);
        let inside = clamp((cosine - light.direction.w) / max(light.specular.w - light.direction.w, 1e-6), 0.0, 1.0);
        strength *= inside * inside * pow(max(cosine, 1e-6), light.ambient.w);
    }
    return vec4<f32>(to_light, strength);
}

// Returns the light of local lights that a matte surface reflects.
fn local_light(in_eye: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    var sum = vec3<f32>(0.0);
    if HAS_LOCAL_LIGHTS {
        for (var i = STAGE_LIGHTS; i < stage.light_count.x; i++) {
            let light = stage.lights[i];
            let way = way_to_light(light, in_eye);
            sum += way.w * (light.ambient.rgb + max(dot(normal, way.xyz), 0.0) * light.diffuse.rgb);
        }
    }
    return sum;
}

// Maps a lit colour to a display, unless the target takes light or a later pass maps its tones.
fn tone_mapped(lit_color: vec3<f32>) -> vec3<f32> {
    if frame.shape.y <= 0.0 {
        return lit_color;
    }
    return compressed(lit_color * frame.shape.y);
}

// Keeps values below 0.76, and rolls highlights off towards white. Khronos PBR Neutral
// (https://github.com/KhronosGroup/ToneMapping) without its offset, which compensates a reflection at normal incidence that
// these materials do not have.
fn compressed(exposed: vec3<f32>) -> vec3<f32> {
    let start = 0.8 - 0.04;
    let peak = max(exposed.r, max(exposed.g, exposed.b));
    if peak < start {
        return exposed;
    }
    let room = 1.0 - start;
    let new_peak = 1.0 - room * room / (peak + room - start);
    let share = 1.0 - 1.0 / (0.15 * (peak - new_peak) + 1.0);
    return mix(exposed * (new_peak / peak), vec3<f32>(new_peak), share);
}

// Returns the light that is displayed as an unlit colour: the colour itself, unless a later pass applies the exposure.
fn displayed(color: vec3<f32>) -> vec3<f32> {
    if frame.shape.y < 0.0 {
        return color / -frame.shape.y;
    }
    return color;
}

// Returns the direction to a point and its distance: from the eye, or from the eye's own plane if rays are parallel.
fn way_to(point: vec3<f32>) -> vec4<f32> {
    if frame.air.w > 0.0 {
        return vec4<f32>(0.0, 0.0, -1.0, max(-point.z, 0.0));
    }
    let distance = length(point);
    return vec4<f32>(point / max(distance, 1e-6), distance);
}

// Returns the light that the air between the eye and a point adds; w is the share of the point's colour that is left.
// Parallel rays all begin at the eye's height.
fn aerial(point: vec3<f32>) -> vec4<f32> {
    if HAS_ATMOSPHERE && frame.shape.w > 0.0 {
        let way = way_to(point);
        let ray = way.xyz;
        let distance = way.w;
        let cosine = dot(ray, frame.up.xyz);
        let range = air_range(frame.air.x, cosine, cosine >= frame.air.y);
        return air_along(ray, cosine, (distance * 1e-3 - range.x) / (range.y - range.x));
    }
    let share = haze(point);
    return vec4<f32>(frame.horizon_color.rgb * share, 1.0 - share);
}

// Returns the same for a part of a ray's way through the air, from 0 to 1.
fn air_along(ray: vec3<f32>, cosine: f32, part: f32) -> vec4<f32> {
    let sun = frame.sun_direction.xyz;
    let across = ray - cosine * frame.up.xyz;
    let sun_across = sun - dot(sun, frame.up.xyz) * frame.up.xyz;
    let size = length(across) * length(sun_across);
    let azimuth = select(0.0, dot(across, sun_across) / size, size > 1e-6);
    let texel = vec3<f32>(
        (0.5 - 0.5 * azimuth) * 31.0,
        air_row(cosine, frame.air.y, frame.air.z),
        air_layer(part),
    );
    let uvw = (texel + 0.5) / vec3<f32>(32.0, 64.0, 24.0);
    let scattered = textureSampleLevel(air_scattered, air_sampler, uvw, 0.0);
    let mie = textureSampleLevel(air_mie, air_sampler, uvw, 0.0).rgb * mie_phase(dot(ray, sun));
    return vec4<f32>(frame.sun_top.rgb * (scattered.rgb + mie), scattered.a);
}

// Returns a lit colour, tone mapped, through the air in front of it.
fn through_air(lit_color: vec3<f32>, air: vec4<f32>) -> vec3<f32> {
    return tone_mapped(lit_color * air.w + air.rgb);
}

// Returns the same for an unlit colour, which is not tone mapped in the fragment's shader.
fn unlit_through_air(color: vec3<f32>, air: vec4<f32>) -> vec3<f32> {
    return displayed(color) * air.w + tone_mapped(air.rgb);
}

// Returns the share of a point's colour that haze hides without an atmosphere, from the mean density of air on the way.
fn haze(point: vec3<f32>) -> f32 {
    if !HAS_HAZE || frame.ambient_color.w <= 0.0 {
        return 0.0;
    }
    let eye_height = frame.up.w * frame.horizon_color.w;
    let point_height = max(above_ground(point).w, 0.0) * frame.horizon_color.w;
    let climb = point_height - eye_height;
    var density = exp(-0.5 * (point_height + eye_height));
    if abs(climb) > 1e-2 {
        density = (exp(-eye_height) - exp(-point_height)) / climb;
    }
    return 1.0 - exp(-frame.ambient_color.w * way_to(point).w * density);
}
