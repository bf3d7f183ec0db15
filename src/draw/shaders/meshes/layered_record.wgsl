// The maps and factors of a surface with layers. It begins like that of a plain one.
struct SurfaceRecord {
    layers: vec4<u32>,    // of base colour, normals, occlusion-roughness-metallic and emission; NO_LAYER without a map
    factors: vec4<f32>,   // metallic, roughness, strength of occlusion, scale of normals
    emission: vec4<f32>,  // linear, in units of lit colours
    occlusion_uv_bits_overlay: vec4<u32>,  // layer of occlusion; a bit for each map with second texture coordinates; layer of the overlay
    uv_matrices: array<vec4<f32>, 4>,  // columns, by map
    uv_offsets: array<vec4<f32>, 2>,   // two maps a vector
    dielectric: vec4<f32>,  // reflectance at normal incidence, linear; w: its strength
    coat: vec4<f32>,        // strength, roughness, scale of normals
    layer_maps: vec4<u32>,  // layers of the maps of dielectric and coat; bits, see layers.wgsl; layer of the coat's normals
    layer_matrices: array<vec4<f32>, 3>,  // columns, by map
    layer_offsets: array<vec4<f32>, 2>,   // two maps a vector
}

@group(1) @binding(12) var dielectric_layers: texture_2d_array<f32>;
@group(1) @binding(13) var dielectric_sampler: sampler;
@group(1) @binding(14) var coat_layers: texture_2d_array<f32>;
@group(1) @binding(15) var coat_sampler: sampler;
@group(1) @binding(16) var coat_normal_layers: texture_2d_array<f32>;
@group(1) @binding(17) var coat_normal_sampler: sampler;
@group(1) @binding(18) var<storage, read> surface_records: array<SurfaceRecord>;

