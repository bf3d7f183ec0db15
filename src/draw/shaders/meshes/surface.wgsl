// Surfaces of glTF's metallic-roughness model under sun, sky and local lights. The reflection of sun and lights is that of
// appendix B of the glTF 2.0 specification: GGX's distribution, Smith's height-correlated visibility, Schlick's Fresnel term.
// What a surface has in memory is in plain_record.wgsl or layered_record.wgsl: `surface_records`. What it reflects beyond the
// plain model is in plain_layers.wgsl or layers.wgsl: `reflectances`, `beneath` and `coated`.

// The maps, as indices of the transforms of second texture coordinates.
const NORMALS: u32 = 0u;
const METALLIC: u32 = 1u;
const EMISSION: u32 = 2u;
const OCCLUSION: u32 = 3u;

const NO_LAYER: u32 = 0xffffffffu;
// Below this roughness, highlights of the sun would be smaller than its disc.
const MIN_ROUGHNESS: f32 = 0.07;

@group(1) @binding(2) var normal_layers: texture_2d_array<f32>;
@group(1) @binding(3) var normal_sampler: sampler;
@group(1) @binding(4) var metallic_layers: texture_2d_array<f32>;
@group(1) @binding(5) var metallic_sampler: sampler;
@group(1) @binding(6) var emission_layers: texture_2d_array<f32>;
@group(1) @binding(7) var emission_sampler: sampler;
@group(1) @binding(8) var occlusion_layers: texture_2d_array<f32>;
@group(1) @binding(9) var occlusion_sampler: sampler;
@group(1) @binding(10) var overlay_layers: texture_2d_array<f32>;
@group(1) @binding(11) var overlay_sampler: sampler;

// The shape of the surface around a pixel, from derivatives, which are not available after branches.
struct MeshShape {
    facet: vec3<f32>,    // normal of the facet, on the side of the eye
    along_x: vec3<f32>,  // change of the position from pixel to pixel, in eye space
    along_y: vec3<f32>,
    uv_x: vec2<f32>,     // change of the texture coordinates
    uv_y: vec2<f32>,
    second_uv_x: vec2<f32>,  // the same of the second ones
    second_uv_y: vec2<f32>,
    bend: f32,           // square of the change of the smooth normal
}

fn mesh_shape(in: MeshFragment) -> MeshShape {
    let uv = vec2<f32>(in.in_eye_u.w, in.normal_v.w);
    let normal = in.normal_v.xyz;
    let smooth_normal = normal * inverseSqrt(max(dot(normal, normal), 1e-12));
    let bend_x = dpdx(smooth_normal);
    let bend_y = dpdy(smooth_normal);
    return MeshShape(
        facet_normal(in.in_eye_u.xyz),
        dpdx(in.in_eye_u.xyz),
        dpdy(in.in_eye_u.xyz),
        dpdx(uv),
        dpdy(uv),
        dpdx(in.second_uv),
        dpdy(in.second_uv),
        dot(bend_x, bend_x) + dot(bend_y, bend_y),
    );
}

// Returns the shape of lines and points.
fn thin_shape() -> MeshShape {
    var shape: MeshShape;
    shape.facet = frame.up.xyz;
    return shape;
}

// The texture coordinates of a map, and their change from pixel to pixel.
struct MapPoint {
    uv: vec2<f32>,
    x: vec2<f32>,
    y: vec2<f32>,
}

fn map_point(in: MeshFragment, shape: MeshShape, map: u32) -> MapPoint {
    let record = in.leaf.x;
    if (surface_records[record].occlusion_uv_bits_overlay.y >> map & 1u) == 0u {
        return MapPoint(vec2<f32>(in.in_eye_u.w, in.normal_v.w), shape.uv_x, shape.uv_y);
    }
    let offsets = surface_records[record].uv_offsets[map / 2u];
    let offset = select(offsets.xy, offsets.zw, (map & 1u) == 1u);
    return second_point(in, shape, surface_records[record].uv_matrices[map], offset);
}

// Returns the point of a map that uses the second texture coordinates.
fn second_point(in: MeshFragment, shape: MeshShape, columns: vec4<f32>, offset: vec2<f32>) -> MapPoint {
    let matrix = mat2x2<f32>(columns.xy, columns.zw);
    return MapPoint(matrix * in.second_uv + offset, matrix * shape.second_uv_x, matrix * shape.second_uv_y);
}

// Returns the linear colour of the sum of two colours as they are displayed.
fn displayed_sum(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    let gamma = vec3<f32>(2.2);
    let sum = pow(max(a, vec3<f32>(0.0)), 1.0 / gamma) + pow(max(b, vec3<f32>(0.0)), 1.0 / gamma);
    return pow(min(sum, vec3<f32>(1.0)), gamma);
}

fn base_color(in: MeshFragment) -> vec4<f32> {
    let uv = vec2<f32>(in.in_eye_u.w, in.normal_v.w);
    let layer = surface_records[in.leaf.x].layers.x;
    let base = texel(textureSample(color_layers, color_sampler, uv, layer), in.leaf.y) * in.color;
    let overlay_x = dpdx(in.second_uv);
    let overlay_y = dpdy(in.second_uv);
    let overlay = surface_records[in.leaf.x].occlusion_uv_bits_overlay.z;
    if overlay == NO_LAYER || (in.leaf.y & FLAG_UNTEXTURED) != 0u {
        return base;
    }
    let above = textureSampleGrad(overlay_layers, overlay_sampler, in.second_uv, overlay, overlay_x, overlay_y);
    switch surface_records[in.leaf.x].occlusion_uv_bits_overlay.w {
        case 1u: { return vec4<f32>(base.rgb * above.rgb, base.a); }
        case 2u: { return vec4<f32>(displayed_sum(base.rgb, above.rgb), base.a); }
        default: { return vec4<f32>(mix(base.rgb, above.rgb, above.a), base.a); }
    }
}

// Returns a bent normal where one texture coordinate alone changes, as on the skirts of terrain: the other axis is at right angles.
fn bent_along_one_axis(normal: vec3<f32>, bend: vec3<f32>, shape: MeshShape, point: MapPoint) -> vec3<f32> {
    let u = vec2<f32>(point.x.x, point.y.x);
    let v = vec2<f32>(point.x.y, point.y.y);
    let is_u = dot(u, u) >= dot(v, v);
    let change = select(v, u, is_u);
    let along = shape.along_x * change.x + shape.along_y * change.y;
    let axis = along - normal * dot(along, normal);
    let square = dot(axis, axis);
    if square < 1e-37 {
        return normal;
    }
    let unit = axis * inverseSqrt(square);
    let tangent = select(cross(normal, unit), unit, is_u);
    return normalize(bend.x * tangent + bend.y * cross(normal, tangent) + bend.z * normal);
}

// Returns a normal bent by a texel of a normal map. The axes of the map follow from derivatives (C. Schueler, Followup:
// Normal Mapping Without Precomputed Tangents, 2013). Green points up in the image, against v. Seen from behind, a bump is
// a dent.
fn bent_normal(normal: vec3<f32>, bend: vec3<f32>, shape: MeshShape, point: MapPoint, is_front: bool) -> vec3<f32> {
    let x = cross(shape.along_y, normal);
    let y = cross(normal, shape.along_x);
    let tangent = x * point.x.x + y * point.y.x;
    let down = x * point.x.y + y * point.y.y;
    let area = abs(point.x.x * point.y.y - point.x.y * point.y.x);
    if area < 4e-3 * (dot(point.x, point.x) + dot(point.y, point.y)) {
        return bent_along_one_axis(normal, bend, shape, point);
    }
    let square = max(dot(tangent, tangent), dot(down, down));
    if square < 1e-37 {
        return normal;
    }
    let is_turned = (dot(cross(shape.along_x, shape.along_y), shape.facet) < 0.0) == is_front;
    let scale = inverseSqrt(square) * select(1.0, -1.0, is_turned);
    return normalize(scale * (bend.x * tangent - bend.y * down) + bend.z * normal);
}

// Returns scale and offset of the reflectance at normal incidence for light from all around. After B. Karis, Physically
// Based Shading on Mobile, 2014.
fn reflection_of_surroundings(roughness: f32, facing_eye: f32) -> vec2<f32> {
    let r = roughness * vec4<f32>(-1.0, -0.0275, -0.572, 0.022) + vec4<f32>(1.0, 0.0425, 1.04, -0.04);
    let a = min(r.x * r.x, exp2(-9.28 * facing_eye)) * r.x + r.y;
    return vec2<f32>(-1.04, 1.04) * a + r.zw;
}

// Returns the light from a direction, blurred by a roughness: sky above the horizon, sunlit ground below. Without an
// atmosphere, it is the sky's light from around that direction.
fn surroundings(direction: vec3<f32>, roughness: f32, up: vec3<f32>, height_m: f32) -> vec3<f32> {
    let around = light_of_sky(direction, up);
    if !HAS_ATMOSPHERE || frame.shape.z <= 0.0 {
        return around;
    }
    let cosine = dot(direction, frame.up.xyz);
    let sky = air_along(direction, max(cosine, frame.air.y), 1.0).rgb;
    let ground = light_of_sky(-up, up) + 0.2 * light_of_sun(up, up, height_m);
    let width = 0.01 + 0.7 * roughness;
    let sharp = mix(ground, sky, smoothstep(-width, width, dot(direction, up)));
    return mix(sharp, around, roughness * roughness);
}

// Returns what is mirrored of light from one direction, times pi, before Fresnel's term. `between` is the direction halfway
// between light and eye.
fn mirrored_lobe(
    normal: vec3<f32>,
    to_light: vec3<f32>,
    to_eye: vec3<f32>,
    between: vec3<f32>,
    roughness: f32,
) -> f32 {
    let n_l = clamp(dot(normal, to_light), 1e-4, 1.0);
    let n_v = clamp(dot(normal, to_eye), 1e-4, 1.0);
    let n_h = clamp(dot(normal, between), 0.0, 1.0);
    let alpha = roughness * roughness;
    let alpha2 = alpha * alpha;
    let spread = n_h * n_h * (alpha2 - 1.0) + 1.0;
    let distribution = alpha2 / (spread * spread);
    let visibility =
        0.5 / (n_l * sqrt(n_v * n_v * (1.0 - alpha2) + alpha2) + n_v * sqrt(n_l * n_l * (1.0 - alpha2) + alpha2));
    return distribution * visibility;
}

// Returns what a surface reflects of light from one direction, times pi: diffuse and specular reflection. The reflectance is
// that at normal incidence; w at grazing angles.
fn reflected(
    normal: vec3<f32>,
    to_light: vec3<f32>,
    to_eye: vec3<f32>,
    diffuse: vec3<f32>,
    reflectance: vec4<f32>,
    roughness: f32,
) -> vec3<f32> {
    let between = normalize(to_light + to_eye);
    let v_h = clamp(dot(to_eye, between), 0.0, 1.0);
    let fresnel = reflectance.rgb + (reflectance.w - reflectance.rgb) * pow(1.0 - v_h, 5.0);
    return beneath(fresnel) * diffuse + fresnel * mirrored_lobe(normal, to_light, to_eye, between, roughness);
}

// Returns the roughness of a curved surface within a pixel, which looks rougher than it is (Y. Tokuyoshi and A. Kaplanyan,
// Improved Geometric Specular Antialiasing, 2019).
fn roughness_in_pixel(roughness: f32, shape: MeshShape) -> f32 {
    let alpha = max(roughness * roughness, MIN_ROUGHNESS * MIN_ROUGHNESS);
    return sqrt(sqrt(min(alpha * alpha + min(0.5 * shape.bend, 0.18), 1.0)));
}

// A point of a surface and what is around it, in eye space.
struct SurfacePoint {
    smooth_normal: vec3<f32>,
    is_front: bool,
    to_eye: vec3<f32>,
    ground: vec4<f32>,  // the direction away from the ground; w: height in metres
    occlusion: f32,     // the share of the sky's light that arrives
}

fn shade(in: MeshFragment, is_front: bool, shape: MeshShape, base: vec4<f32>) -> vec3<f32> {
    let in_eye = in.in_eye_u.xyz;
    let air = aerial(in_eye);
    if (in.leaf.y & FLAG_UNLIT) != 0u {
        return unlit_through_air(base.rgb, air);
    }
    // Parts of the record, since a copy of all of it for each pixel is slow.
    let layers = surface_records[in.leaf.x].layers;
    let factors = surface_records[in.leaf.x].factors;
    let occlusion_layer = surface_records[in.leaf.x].occlusion_uv_bits_overlay.x;
    let has_maps = (in.leaf.y & FLAG_UNTEXTURED) == 0u;
    var metallic = factors.x;
    var roughness = factors.y;
    var open = 1.0;
    if has_maps && layers.z != NO_LAYER {
        let at = map_point(in, shape, METALLIC);
        let sampled = textureSampleGrad(metallic_layers, metallic_sampler, at.uv, layers.z, at.x, at.y);
        open = sampled.r;
        roughness *= sampled.g;
        metallic *= sampled.b;
    }
    if has_maps && occlusion_layer != NO_LAYER {
        let at = map_point(in, shape, OCCLUSION);
        open = textureSampleGrad(occlusion_layers, occlusion_sampler, at.uv, occlusion_layer, at.x, at.y).r;
    }
    let occlusion = 1.0 + factors.z * (open - 1.0);
    var emission = surface_records[in.leaf.x].emission.rgb;
    if has_maps && layers.w != NO_LAYER {
        let at = map_point(in, shape, EMISSION);
        emission *= textureSampleGrad(emission_layers, emission_sampler, at.uv, layers.w, at.x, at.y).rgb;
    }
    let smooth_normal = surface_normal(in.normal_v.xyz, is_front, shape.facet);
    var normal = smooth_normal;
    if has_maps && layers.y != NO_LAYER {
        let at = map_point(in, shape, NORMALS);
        let sampled = textureSampleGrad(normal_layers, normal_sampler, at.uv, layers.y, at.x, at.y);
        let bend = (sampled.xyz * 2.0 - 1.0) * vec3<f32>(factors.ww, 1.0);
        normal = bent_normal(smooth_normal, bend, shape, at, is_front);
    }
    roughness = roughness_in_pixel(roughness, shape);

    let ground = above_ground(in_eye);
    let to_eye = -way_to(in_eye).xyz;
    let diffuse = base.rgb * (1.0 - metallic);
    let reflectance = reflectances(in, shape, base.rgb, metallic);
    var color = emission;
    if dot(normal, frame.sun_direction.xyz) > 0.0 {
        let sun = light_of_sun(normal, ground.xyz, ground.w) * sun_shadow(in_eye, towards_sun(smooth_normal, shape.facet));
        color += sun * reflected(normal, frame.sun_direction.xyz, to_eye, diffuse, reflectance, roughness);
    }
    if HAS_LOCAL_LIGHTS {
        for (var i = STAGE_LIGHTS; i < stage.light_count.x; i++) {
            let light = stage.lights[i];
            let way = way_to_light(light, in_eye);
            let facing = max(dot(normal, way.xyz), 0.0);
            color += way.w * light.ambient.rgb * diffuse;
            if facing > 0.0 {
                let mirrored = reflected(normal, way.xyz, to_eye, diffuse, reflectance, roughness);
                color += way.w * facing * light.diffuse.rgb * mirrored;
            }
        }
    }
    let facing_eye = clamp(dot(normal, to_eye), 0.0, 1.0);
    let from_around = reflection_of_surroundings(roughness, facing_eye);
    let mirrored = reflectance.rgb * from_around.x + reflectance.w * from_around.y;
    let glossy = surroundings(reflect(-to_eye, normal), roughness, ground.xyz, ground.w) * mirrored;
    let soft = light_of_sky(normal, ground.xyz) * diffuse * beneath(mirrored);
    let point = SurfacePoint(smooth_normal, is_front, to_eye, ground, occlusion);
    return through_air(coated(in, shape, point, color + occlusion * (glossy + soft)), air);
}
