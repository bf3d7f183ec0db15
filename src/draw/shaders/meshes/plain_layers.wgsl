// Surfaces of the plain model, which have none of the layers in layers.wgsl.

fn reflectances(in: MeshFragment, shape: MeshShape, base: vec3<f32>, metallic: f32) -> vec4<f32> {
    return vec4<f32>(mix(vec3<f32>(0.04), base, metallic), 1.0);
}

fn beneath(mirrored: vec3<f32>) -> vec3<f32> {
    return 1.0 - mirrored;
}

fn coated(in: MeshFragment, shape: MeshShape, point: SurfacePoint, lit: vec3<f32>) -> vec3<f32> {
    return lit;
}
