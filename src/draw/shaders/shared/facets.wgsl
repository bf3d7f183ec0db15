// Facet normals, from the screen-space derivatives of positions.

// Returns the normal of the facet at a point, on the side of the eye.
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

// Returns the normal for the look-up of a shadow. It is the facet's, since facets cast; the smooth normal is taken where the
// sun is behind the facet.
fn towards_sun(normal: vec3<f32>, facet: vec3<f32>) -> vec3<f32> {
    return select(normal, facet, dot(facet, frame.sun_direction.xyz) > 0.0);
}
