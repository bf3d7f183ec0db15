// Surfaces that reflect more than the plain model says: the reflection of dielectrics with an index of refraction, a strength and a
// colour (KHR_materials_ior, KHR_materials_specular), and a clear coat (KHR_materials_clearcoat).

// The maps, as indices of their transforms. Bits of a record say which of them use the second texture coordinates.
const DIELECTRIC: u32 = 0u;
const COAT: u32 = 1u;
const COAT_NORMALS: u32 = 2u;
// Further bits of a record: the parts of maps that count.
const DIELECTRIC_MAP_HAS_COLOR: u32 = 8u;
const DIELECTRIC_MAP_HAS_STRENGTH: u32 = 16u;
const COAT_MAP_HAS_STRENGTH: u32 = 32u;
const COAT_MAP_HAS_ROUGHNESS: u32 = 64u;

// The share of light that the coat reflects at normal incidence, with an index of refraction of 1.5.
const COAT_REFLECTANCE: f32 = 0.04;

fn layer_point(in: MeshFragment, shape: MeshShape, map: u32) -> MapPoint {
    let record = in.leaf.x;
    if (surface_records[record].layer_maps.z >> map & 1u) == 0u {
        return MapPoint(vec2<f32>(in.in_eye_u.w, in.normal_v.w), shape.uv_x, shape.uv_y);
    }
    let offsets = surface_records[record].layer_offsets[map / 2u];
    let offset = select(offsets.xy, offsets.zw, (map & 1u) == 1u);
    return second_point(in, shape, surface_records[record].layer_matrices[map], offset);
}

// Returns what a surface reflects at normal incidence; w: at grazing angles.
fn reflectances(in: MeshFragment, shape: MeshShape, base: vec3<f32>, metallic: f32) -> vec4<f32> {
    var dielectric = surface_records[in.leaf.x].dielectric;
    let maps = surface_records[in.leaf.x].layer_maps;
    if (in.leaf.y & FLAG_UNTEXTURED) == 0u && maps.x != NO_LAYER {
        let at = layer_point(in, shape, DIELECTRIC);
        let sampled = textureSampleGrad(dielectric_layers, dielectric_sampler, at.uv, maps.x, at.x, at.y);
        let color = select(vec3<f32>(1.0), sampled.rgb, (maps.z & DIELECTRIC_MAP_HAS_COLOR) != 0u);
        let strength = select(1.0, sampled.a, (maps.z & DIELECTRIC_MAP_HAS_STRENGTH) != 0u);
        dielectric *= vec4<f32>(color, strength);
    }
    let color = min(dielectric.rgb, vec3<f32>(1.0)) * dielectric.w;
    return vec4<f32>(mix(color, base, metallic), mix(dielectric.w, 1.0, metallic));
}

// Returns the share of light that enters a surface. A coloured reflection does not tint it.
fn beneath(mirrored: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(1.0 - max(mirrored.r, max(mirrored.g, mirrored.b)));
}

// Returns the light of a surface through its coat, and what the coat mirrors of sun, local lights and sky.
fn coated(in: MeshFragment, shape: MeshShape, point: SurfacePoint, lit: vec3<f32>) -> vec3<f32> {
    var coat = surface_records[in.leaf.x].coat;
    let maps = surface_records[in.leaf.x].layer_maps;
    let has_maps = (in.leaf.y & FLAG_UNTEXTURED) == 0u;
    if has_maps && maps.y != NO_LAYER {
        let at = layer_point(in, shape, COAT);
        let sampled = textureSampleGrad(coat_layers, coat_sampler, at.uv, maps.y, at.x, at.y);
        coat.x *= select(1.0, sampled.r, (maps.z & COAT_MAP_HAS_STRENGTH) != 0u);
        coat.y *= select(1.0, sampled.g, (maps.z & COAT_MAP_HAS_ROUGHNESS) != 0u);
    }
    if coat.x <= 0.0 {
        return lit;
    }
    let roughness = roughness_in_pixel(coat.y, shape);
    var normal = point.smooth_normal;
    if has_maps && maps.w != NO_LAYER {
        let at = layer_point(in, shape, COAT_NORMALS);
        let sampled = textureSampleGrad(coat_normal_layers, coat_normal_sampler, at.uv, maps.w, at.x, at.y);
        let bend = (sampled.xyz * 2.0 - 1.0) * vec3<f32>(coat.zz, 1.0);
        normal = bent_normal(normal, bend, shape, at, point.is_front);
    }
    let facing_eye = min(abs(dot(normal, point.to_eye)), 1.0);
    let fresnel = COAT_REFLECTANCE + (1.0 - COAT_REFLECTANCE) * pow(1.0 - facing_eye, 5.0);
    let in_eye = in.in_eye_u.xyz;
    let sun = frame.sun_direction.xyz;
    var mirrored = vec3<f32>(0.0);
    if dot(normal, sun) > 0.0 {
        let light = light_of_sun(normal, point.ground.xyz, point.ground.w)
            * sun_shadow(in_eye, towards_sun(point.smooth_normal, shape.facet));
        mirrored += light * mirrored_lobe(normal, sun, point.to_eye, normalize(sun + point.to_eye), roughness);
    }
    if HAS_LOCAL_LIGHTS {
        for (var i = STAGE_LIGHTS; i < stage.light_count.x; i++) {
            let light = stage.lights[i];
            let way = way_to_light(light, in_eye);
            let facing = dot(normal, way.xyz);
            if facing > 0.0 {
                let between = normalize(way.xyz + point.to_eye);
                let lobe = mirrored_lobe(normal, way.xyz, point.to_eye, between, roughness);
                mirrored += way.w * facing * light.diffuse.rgb * lobe;
            }
        }
    }
    let from_around = reflection_of_surroundings(roughness, facing_eye);
    let around = surroundings(reflect(-point.to_eye, normal), roughness, point.ground.xyz, point.ground.w);
    let glossy = point.occlusion * around * (COAT_REFLECTANCE * from_around.x + from_around.y);
    return lit * (1.0 - coat.x * fresnel) + coat.x * (fresnel * mirrored + glossy);
}
