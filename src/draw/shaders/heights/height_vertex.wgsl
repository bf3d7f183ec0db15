// Makes the vertices of height tiles look like those of meshes, for programs.

struct MeshVertex {
    position: vec3<f32>,
    uv: vec2<f32>,
    normal: vec4<f32>,
    color: vec4<f32>,
}

fn height_vertex(index: u32, instance: u32) -> MeshVertex {
    let point = height_point(index, instance);
    return MeshVertex(point.in_tile, point.uv, vec4<f32>(normalize(point.facing), 0.0), vec4<f32>(1.0));
}
