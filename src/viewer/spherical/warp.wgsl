// Warps six images of the surroundings into one for a dome or a panorama. Each is 90 degrees wide and high.

struct Display {
    // 0: dome, 1: panorama.
    projection: u32,
    // The distance of the projector behind the viewer, in radii of the dome.
    projector_distance: f32,
    size_px: vec2<f32>,
}

@group(0) @binding(0) var<uniform> display: Display;
@group(0) @binding(1) var image_sampler: sampler;
@group(0) @binding(2) var front: texture_2d<f32>;
@group(0) @binding(3) var right: texture_2d<f32>;
@group(0) @binding(4) var back: texture_2d<f32>;
@group(0) @binding(5) var left: texture_2d<f32>;
@group(0) @binding(6) var up: texture_2d<f32>;
@group(0) @binding(7) var down: texture_2d<f32>;

// True for targets without sRGB format, whose values are encoded here.
override ENCODES: bool = false;

const PI: f32 = 3.14159265358979;

@vertex
fn vs_main(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
    // A triangle that covers the target.
    return vec4<f32>(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// Samples a face at a direction in its eye space, which looks along -z.
fn face(image: texture_2d<f32>, direction: vec3<f32>) -> vec3<f32> {
    let at = direction.xy / -direction.z;
    return textureSampleLevel(image, image_sampler, vec2<f32>(0.5 + 0.5 * at.x, 0.5 - 0.5 * at.y), 0.0).rgb;
}

// The colour in a direction of the master camera's eye space: x to the right, y up, -z ahead.
fn surroundings(d: vec3<f32>) -> vec3<f32> {
    let a = abs(d);
    if a.z >= a.x && a.z >= a.y {
        if d.z <= 0.0 { return face(front, d); }
        return face(back, vec3<f32>(-d.x, d.y, -d.z));
    }
    if a.x >= a.y {
        if d.x >= 0.0 { return face(right, vec3<f32>(d.z, d.y, -d.x)); }
        return face(left, vec3<f32>(-d.z, d.y, d.x));
    }
    if d.y >= 0.0 { return face(up, vec3<f32>(d.x, d.z, -d.y)); }
    return face(down, vec3<f32>(d.x, -d.z, d.y));
}

fn encoded(linear: vec3<f32>) -> vec3<f32> {
    let low = 12.92 * linear;
    let high = 1.055 * pow(linear, vec3<f32>(1.0 / 2.4)) - 0.055;
    return select(high, low, linear <= vec3<f32>(0.0031308));
}

@fragment
fn fs_main(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    var color = vec3<f32>(0.0);
    if display.projection == 0u {
        // From the middle of the target upwards and to the right, in halves of its shorter side.
        let from_middle = (position.xy - 0.5 * display.size_px) * vec2<f32>(1.0, -1.0);
        let delta = from_middle / (0.5 * min(display.size_px.x, display.size_px.y));
        let r = length(delta);
        if r > 1.0 {
            return vec4<f32>(0.0, 0.0, 0.0, 1.0);
        }
        // The angle from the projector's axis, then that from the viewer's, who sees the point of the dome.
        let phi = 0.5 * PI * r;
        let f = display.projector_distance * sin(phi);
        let e = display.projector_distance * cos(phi) + sqrt(1.0 - f * f);
        let gamma = atan2(e * sin(phi), e * cos(phi) - display.projector_distance);
        let around = delta / max(r, 1e-6);
        color = surroundings(vec3<f32>(sin(gamma) * around, -cos(gamma)));
    } else {
        let share = position.xy / display.size_px;
        let longitude = (share.x - 0.5) * 2.0 * PI;
        let latitude = (0.5 - share.y) * PI;
        color = surroundings(vec3<f32>(cos(latitude) * sin(longitude), sin(latitude), -cos(latitude) * cos(longitude)));
    }
    if ENCODES {
        color = encoded(color);
    }
    return vec4<f32>(color, 1.0);
}
