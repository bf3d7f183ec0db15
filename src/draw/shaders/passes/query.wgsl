// The box of an occlusion query. Depth is tested, and nothing is written.

@vertex
fn vs_query(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> @builtin(position) vec4<f32> {
    // Six faces of two triangles: axis and side from the face, corners from the rest.
    let face = index / 6u;
    let axis = face / 2u;
    let side = f32(face % 2u) * 2.0 - 1.0;
    let corner = index % 6u;
    let u = select(-1.0, 1.0, corner == 1u || corner == 2u || corner == 4u);
    let v = select(-1.0, 1.0, corner == 2u || corner == 4u || corner == 5u);
    var point = vec3<f32>(side, u, v);
    if axis == 1u {
        point = vec3<f32>(u, side, v);
    } else if axis == 2u {
        point = vec3<f32>(u, v, side);
    }
    let leaf = leaves[instance];
    return clip_of(leaf, point_in_eye(leaf, point));
}

@fragment
fn fs_query() -> @location(0) vec4<f32> {
    return vec4<f32>(0.0);
}
