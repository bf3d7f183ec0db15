// The maps and factors of a surface of the plain metallic-roughness model.
struct SurfaceRecord {
    layers: vec4<u32>,    // of base colour, normals, occlusion-roughness-metallic and emission; NO_LAYER without a map
    factors: vec4<f32>,   // metallic, roughness, strength of occlusion, scale of normals
    emission: vec4<f32>,  // linear, in units of lit colours
    occlusion_uv_bits_overlay: vec4<u32>,  // layer of occlusion; a bit for each map with second texture coordinates; layer of the overlay
    uv_matrices: array<vec4<f32>, 4>,  // columns, by map
    uv_offsets: array<vec4<f32>, 2>,   // two maps a vector
}

@group(1) @binding(12) var<storage, read> surface_records: array<SurfaceRecord>;

