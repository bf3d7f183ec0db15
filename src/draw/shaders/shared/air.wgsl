// The layout of the air tables, shared by the shaders that write them (atmosphere.wgsl) and those that read them.

const EARTH_KM: f32 = 6371.0;
const AIR_KM: f32 = 6471.0;
const LOWEST_KM: f32 = 6368.0;
const SUN_RADIUS: f32 = 0.0047;  // radians

// Returns the cosine of the angle from the zenith to the horizon at a height. Heights are in kilometres.
fn horizon_cosine(height: f32) -> f32 {
    let h = max(height, 0.0);
    return -sqrt(h * (2.0 * EARTH_KM + h)) / (EARTH_KM + h);
}

// Returns the texture coordinates of a height and a cosine from the zenith in the table of sunlight.
fn sunlight_place(height: f32, cosine: f32) -> vec2<f32> {
    let h = clamp(height, 0.0, 100.0);
    let horizon = horizon_cosine(h);
    let at = vec2<f32>(sqrt(max((cosine - horizon) / (1.0 - horizon), 0.0)), sqrt(h / 100.0));
    return (at * vec2<f32>(127.0, 63.0) + 0.5) / vec2<f32>(128.0, 64.0);
}

// Returns the share of the sun's disc above the horizon.
fn sun_share(height: f32, cosine: f32) -> f32 {
    return smoothstep(-SUN_RADIUS, SUN_RADIUS, cosine - horizon_cosine(height));
}

// Returns the cosine of the sun from the zenith at a position in the table of the sky's light, from 0 to 1.
fn sky_light_cosine(position: f32) -> f32 {
    return mix(-0.3, 1.0, position);
}

// Returns the texture coordinate of a cosine in the table of the sky's light; the inverse of `sky_light_cosine`.
fn sky_light_place(cosine: f32) -> f32 {
    return (clamp((cosine + 0.3) / 1.3, 0.0, 1.0) * 63.0 + 0.5) / 64.0;
}

// Returns the phase function of aerosols by the cosine of the scattering angle: Henyey and Greenstein's with g = 0.8.
fn mie_phase(cosine: f32) -> f32 {
    let g = 0.8;
    let d = 1.0 + g * g - 2.0 * g * cosine;
    return (1.0 - g * g) / (4.0 * 3.14159265 * d * sqrt(d));
}

// Returns the direction of a position in the table of the air, from 0 to 1: the cosine of the azimuth from the sun, and the
// cosine from the zenith. Rows lie below and above the horizon of the lowest ground, closer together near it. Columns go
// from the sun's azimuth to the opposite one.
fn air_direction(uv: vec2<f32>, is_above: bool, horizon: f32, limb: f32) -> vec2<f32> {
    // 64 rows: the halves are 0 to 31 / 63 and 32 / 63 to 1.
    let below = 1.0 - uv.y * (63.0 / 31.0);
    let above = (uv.y * 63.0 - 32.0) / 31.0;
    let cosine = select(horizon - (1.0 + horizon) * below * below, horizon + (limb - horizon) * above * above, is_above);
    return vec2<f32>(1.0 - 2.0 * uv.x, cosine);
}

// Returns the row of a cosine from the zenith; the inverse of `air_direction`.
fn air_row(cosine: f32, horizon: f32, limb: f32) -> f32 {
    if cosine >= horizon {
        return 32.0 + 31.0 * sqrt(clamp((cosine - horizon) / (limb - horizon), 0.0, 1.0));
    }
    return 31.0 - 31.0 * sqrt(clamp((horizon - cosine) / (1.0 + horizon), 0.0, 1.0));
}

// Returns the layer of a part of a ray's way, from 0 to 1. The layers lie at squares of 1 / 23; between two of them the layer
// grows with the distance, so that the air near the eye does too.
fn air_layer(part: f32) -> f32 {
    let square = clamp(part, 0.0, 1.0) * (23.0 * 23.0);
    let layer = floor(sqrt(square));
    return layer + (square - layer * layer) / (2.0 * layer + 1.0);
}

// Returns the distances in kilometres at which a ray enters the air, and leaves it or meets the lowest ground.
fn air_range(from_center: f32, cosine: f32, is_above: bool) -> vec2<f32> {
    let b = from_center * cosine;
    let top = (from_center - AIR_KM) * (from_center + AIR_KM);
    let root = sqrt(max(b * b - top, 0.0));
    var enters = 0.0;
    var leaves = 0.0;
    if top > 0.0 {
        if b < 0.0 {
            enters = top / (-b + root);
            leaves = -b + root;
        }
    } else {
        leaves = select(-b + root, -top / (b + root), b > 0.0);
    }
    if !is_above {
        let ground = (from_center - LOWEST_KM) * (from_center + LOWEST_KM);
        leaves = ground / (-b + sqrt(max(b * b - ground, 0.0)));
    }
    return vec2<f32>(enters, max(leaves, enters + 1e-6));
}
