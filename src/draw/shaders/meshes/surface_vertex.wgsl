// The vertices of meshes with a metallic-roughness surface, and the textures of their base colour.

@group(1) @binding(0) var color_layers: texture_2d_array<f32>;
@group(1) @binding(1) var color_sampler: sampler;

struct MeshVertex {
    @location(0) position: vec3<f32>,
    @location(1) uv: vec2<f32>,
    @location(2) normal: vec4<f32>,
    @location(3) color: vec4<f32>,
    // The first texture coordinates again if the mesh has no second ones.
    @location(4) second_uv: vec2<f32>,
}
