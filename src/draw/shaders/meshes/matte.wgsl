// Matte materials: they reflect sun and sky equally in all directions (Lambert).

// The shape of the surface around a pixel, from derivatives.
struct MeshShape {
    facet: vec3<f32>,  // normal of the facet, on the side of the eye
}

fn mesh_shape(in: MeshFragment) -> MeshShape {
    return MeshShape(facet_normal(in.in_eye_u.xyz));
}

// Returns the shape of lines and points.
fn thin_shape() -> MeshShape {
    return MeshShape(frame.up.xyz);
}

fn base_color(in: MeshFragment) -> vec4<f32> {
    let uv = vec2<f32>(in.in_eye_u.w, in.normal_v.w);
    return texel(textureSample(color_layers, color_sampler, uv, in.leaf.x), in.leaf.y) * in.color;
}

fn shade(in: MeshFragment, is_front: bool, shape: MeshShape, base: vec4<f32>) -> vec3<f32> {
    let air = aerial(in.in_eye_u.xyz);
    if (in.leaf.y & FLAG_UNLIT) != 0u {
        return unlit_through_air(base.rgb, air);
    }
    let ground = above_ground(in.in_eye_u.xyz);
    let normal = surface_normal(in.normal_v.xyz, is_front, shape.facet);
    var lit = light_of_sun(normal, ground.xyz, ground.w);
    if dot(normal, frame.sun_direction.xyz) > 0.0 {
        lit *= sun_shadow(in.in_eye_u.xyz, towards_sun(normal, shape.facet));
    }
    let around = light_of_sky(normal, ground.xyz) + local_light(in.in_eye_u.xyz, normal);
    return through_air(base.rgb * (lit + around), air);
}
