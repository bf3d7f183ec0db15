// Computes the tables of the air: those of the whole earth (sunlight, multiple, sky_light) and those of one eye (air). After
// S. Hillaire, A Scalable and Production Ready Sky and Atmosphere Rendering Technique, 2020, with other tables. Lengths are
// in kilometres.

struct Air {
    eye: vec4<f32>,      // distance from the earth's centre; cosines from the zenith of the horizon of the lowest ground,
                         // of the air's limb and of the sun
    aerosol: vec4<f32>,  // extinction at height 0
}

const PI: f32 = 3.14159265;

const RAYLEIGH: vec3<f32> = vec3<f32>(5.802e-3, 13.558e-3, 33.1e-3);
const OZONE: vec3<f32> = vec3<f32>(0.650e-3, 1.881e-3, 0.085e-3);
const MIE_ALBEDO: f32 = 0.9;
const GROUND_ALBEDO: f32 = 0.2;

@group(0) @binding(0) var<uniform> air: Air;
@group(0) @binding(1) var linear_clamp: sampler;
@group(0) @binding(2) var sunlight: texture_2d<f32>;
@group(0) @binding(3) var multiple: texture_2d<f32>;
@group(0) @binding(4) var out_plane: texture_storage_2d<rgba16float, write>;
@group(0) @binding(5) var out_scattered: texture_storage_3d<rgba16float, write>;
@group(0) @binding(6) var out_mie: texture_storage_3d<rgba16float, write>;

// Scattering and extinction per kilometre.
struct Medium {
    rayleigh: vec3<f32>,
    mie: f32,
    extinction: vec3<f32>,
}

fn medium(height: f32) -> Medium {
    let h = max(height, 0.0);
    let rayleigh = RAYLEIGH * exp(-h / 8.0);
    let mie = air.aerosol.x * exp(-h / 1.2);
    let ozone = OZONE * max(0.0, 1.0 - abs(h - 25.0) / 15.0);
    return Medium(rayleigh, MIE_ALBEDO * mie, rayleigh + mie + ozone);
}

// Returns the distance along a ray from inside a sphere around the earth's centre to the sphere.
fn to_sphere(radius: f32, from_center: f32, cosine: f32) -> f32 {
    let b = from_center * cosine;
    return -b + sqrt(max(b * b - (from_center - radius) * (from_center + radius), 0.0));
}

// Returns the distance at which a ray from inside the air ends: at the ground, or at the top of the air.
fn ray_end(from_center: f32, cosine: f32, ground: f32) -> f32 {
    let b = from_center * cosine;
    let c = (from_center - ground) * (from_center + ground);
    if b < 0.0 && b * b > c {
        return c / (-b + sqrt(b * b - c));
    }
    return to_sphere(AIR_KM, from_center, cosine);
}

fn sampled_sunlight(height: f32, cosine: f32) -> vec3<f32> {
    return textureSampleLevel(sunlight, linear_clamp, sunlight_place(height, cosine), 0.0).rgb * sun_share(height, cosine);
}

fn sampled_multiple(height: f32, cosine: f32) -> vec3<f32> {
    let size = vec2<f32>(textureDimensions(multiple));
    let at = vec2<f32>(0.5 + 0.5 * cosine, sqrt(clamp(height / 100.0, 0.0, 1.0)));
    return textureSampleLevel(multiple, linear_clamp, (at * (size - 1.0) + 0.5) / size, 0.0).rgb;
}

// Computes the share of sunlight that reaches a height, by the sun's elevation above the horizon there.
@compute @workgroup_size(8, 8)
fn cs_sunlight(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = vec2<f32>(id.xy) / (vec2<f32>(textureDimensions(out_plane)) - 1.0);
    let height = 100.0 * at.y * at.y;
    let from_center = EARTH_KM + height;
    let horizon = horizon_cosine(height);
    let cosine = horizon + (1.0 - horizon) * at.x * at.x;
    let step = to_sphere(AIR_KM, from_center, cosine) / 64.0;
    var depth = vec3<f32>(0.0);
    for (var i = 0; i < 64; i++) {
        let t = (f32(i) + 0.5) * step;
        let h = sqrt(from_center * from_center + t * t + 2.0 * from_center * t * cosine) - EARTH_KM;
        depth += medium(h).extinction * step;
    }
    textureStore(out_plane, id.xy, vec4<f32>(exp(-depth), 1.0));
}

// Returns one of `count` directions that are spread evenly over the sphere.
fn direction_of(i: u32, count: u32) -> vec3<f32> {
    let z = 1.0 - (2.0 * f32(i) + 1.0) / f32(count);
    let around = f32(i) * 2.3999632;
    let across = sqrt(max(1.0 - z * z, 0.0));
    return vec3<f32>(across * cos(around), across * sin(around), z);
}

// Computes light that was scattered twice or more, taken as equal from all directions (section 5.5).
@compute @workgroup_size(8, 8)
fn cs_multiple(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = vec2<f32>(id.xy) / (vec2<f32>(textureDimensions(out_plane)) - 1.0);
    let height = 100.0 * at.y * at.y;
    let sun_cosine = 2.0 * at.x - 1.0;
    let from_center = EARTH_KM + height;
    let sun = vec3<f32>(sqrt(max(1.0 - sun_cosine * sun_cosine, 0.0)), 0.0, sun_cosine);
    var second = vec3<f32>(0.0);
    var share = vec3<f32>(0.0);
    for (var i = 0u; i < 32u; i++) {
        let ray = direction_of(i, 32u);
        let end = ray_end(from_center, ray.z, EARTH_KM);
        let step = end / 20.0;
        var through = vec3<f32>(1.0);
        for (var k = 0; k < 20; k++) {
            let p = vec3<f32>(0.0, 0.0, from_center) + ray * ((f32(k) + 0.5) * step);
            let r = length(p);
            let m = medium(r - EARTH_KM);
            let scattering = m.rayleigh + m.mie;
            let kept = exp(-m.extinction * step);
            let integral = through * (scattering - scattering * kept) / max(m.extinction, vec3<f32>(1e-9));
            second += integral * sampled_sunlight(r - EARTH_KM, dot(p, sun) / r) / (4.0 * PI);
            share += integral;
            through *= kept;
        }
        if ray.z < horizon_cosine(height) {
            let p = vec3<f32>(0.0, 0.0, from_center) + ray * end;
            let facing = dot(p, sun) / length(p);
            second += through * GROUND_ALBEDO / PI * max(facing, 0.0) * sampled_sunlight(0.0, facing);
        }
    }
    let scattered = (second / 32.0) / (1.0 - share / 32.0);
    textureStore(out_plane, id.xy, vec4<f32>(scattered, 1.0));
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 3.0 / (16.0 * PI) * (1.0 + cosine * cosine);
}

// Returns the light of the whole sky on level ground, by the sun's cosine from the zenith.
fn sky_on_ground(sun_cosine: f32) -> vec3<f32> {
    let sun = vec3<f32>(sqrt(max(1.0 - sun_cosine * sun_cosine, 0.0)), 0.0, sun_cosine);
    let from_center = EARTH_KM + 0.05;
    var light = vec3<f32>(0.0);
    for (var i = 0u; i < 64u; i++) {
        let ray = direction_of(i, 128u);
        let cosine = dot(ray, sun);
        let end = to_sphere(AIR_KM, from_center, ray.z);
        var through = vec3<f32>(1.0);
        var before = 0.0;
        for (var k = 1; k <= 20; k++) {
            let t = end * f32(k * k) / 400.0;
            let p = vec3<f32>(0.0, 0.0, from_center) + ray * (0.5 * (before + t));
            let r = length(p);
            let m = medium(r - EARTH_KM);
            let sun_here = dot(p, sun) / r;
            let kept = exp(-m.extinction * (t - before));
            let direct = m.rayleigh * rayleigh_phase(cosine) + m.mie * mie_phase(cosine);
            let around = (m.rayleigh + m.mie) * sampled_multiple(r - EARTH_KM, sun_here);
            let source = direct * sampled_sunlight(r - EARTH_KM, sun_here) + around;
            light += ray.z * through * source * (1.0 - kept) / max(m.extinction, vec3<f32>(1e-9));
            through *= kept;
            before = t;
        }
    }
    return light * (2.0 * PI / 64.0);
}

// Computes the light of the sky relative to that under a sun in the zenith.
@compute @workgroup_size(8, 8)
fn cs_sky_light(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(out_plane);
    if id.x >= size.x || id.y >= size.y {
        return;
    }
    let light = sky_on_ground(sky_light_cosine(f32(id.x) / (f32(size.x) - 1.0)));
    textureStore(out_plane, id.xy, vec4<f32>(light / sky_on_ground(1.0), 1.0));
}

// Computes the light that the air adds along each direction from the eye, up to distances that lie closer together near the
// eye. One table has light scattered by air and scattered more than once, and the share of light left from beyond. The
// other has light scattered once by aerosols, without its phase function.
@compute @workgroup_size(8, 8)
fn cs_air(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(out_scattered);
    let direction = air_direction(vec2<f32>(id.xy) / (vec2<f32>(size.xy) - 1.0), id.y * 2u >= size.y, air.eye.y, air.eye.z);
    let sun_cosine = air.eye.w;
    let sun = vec3<f32>(sqrt(max(1.0 - sun_cosine * sun_cosine, 0.0)), 0.0, sun_cosine);
    let across = sqrt(max(1.0 - direction.y * direction.y, 0.0));
    let ray = vec3<f32>(across * direction.x, across * sqrt(max(1.0 - direction.x * direction.x, 0.0)), direction.y);
    let range = air_range(air.eye.x, ray.z, id.y * 2u >= size.y);
    let cosine = dot(ray, sun);
    var through = vec3<f32>(1.0);
    var scattered = vec3<f32>(0.0);
    var mie = vec3<f32>(0.0);
    var before = 0.0;
    textureStore(out_scattered, vec3<u32>(id.xy, 0u), vec4<f32>(0.0, 0.0, 0.0, 1.0));
    textureStore(out_mie, vec3<u32>(id.xy, 0u), vec4<f32>(0.0));
    for (var k = 1u; k < size.z; k++) {
        let part = f32(k) / (f32(size.z) - 1.0);
        let t = (range.y - range.x) * part * part;
        let p = vec3<f32>(0.0, 0.0, air.eye.x) + ray * (range.x + 0.5 * (before + t));
        let r = length(p);
        let height = r - EARTH_KM;
        let m = medium(height);
        let sun_here = dot(p, sun) / r;
        let light = sampled_sunlight(height, sun_here);
        let kept = exp(-m.extinction * (t - before));
        let reached = through * (1.0 - kept) / max(m.extinction, vec3<f32>(1e-9));
        scattered += reached
            * (m.rayleigh * rayleigh_phase(cosine) * light + (m.rayleigh + m.mie) * sampled_multiple(height, sun_here));
        mie += reached * m.mie * light;
        through *= kept;
        before = t;
        textureStore(out_scattered, vec3<u32>(id.xy, k), vec4<f32>(scattered, dot(through, vec3<f32>(1.0 / 3.0))));
        textureStore(out_mie, vec3<u32>(id.xy, k), vec4<f32>(mie, 1.0));
    }
}
