// Facets of what is drawn, from the derivatives of places.

// The facet's normal, towards the eye.
fn facet_normal(in_eye: vec3<f32>) -> vec3<f32> {
    let across = cross(dpdx(in_eye), dpdy(in_eye));
    let size = length(across);
    if size < 1e-30 {
        return frame.up.xyz;
    }
    let normal = across / size;
    let from_eye = select(in_eye, vec3<f32>(0.0, 0.0, -1.0), frame.air.w > 0.0);
    return select(normal, -normal, dot(normal, from_eye) > 0.0);
}

// The normal that a shadow is looked up with: that of the facet, which is what casts; where the sun only grazes a
// smooth surface's facets from behind, the smooth one.
fn towards_sun(normal: vec3<f32>, facet: vec3<f32>) -> vec3<f32> {
    return select(normal, facet, dot(facet, frame.sun_direction.xyz) > 0.0);
}
