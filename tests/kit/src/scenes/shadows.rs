//! Shadows: a tower on the ground, and the pixels that its shadow must cover, computed from rays.

use std::sync::Arc;

use glam::{DVec3, DVec4};
use image::RgbaImage;
use terrane::cull::{CullCamera, StageShadows};

use terrane::math::Aabb;
use terrane::scene::{Drawable, Environment, Geometry, Material, Mesh, SunShadows};

use crate::frames::srgb;
use crate::rig::plain;

/// Returns an environment with sun, shadows and even ambient light, without an atmosphere.
pub fn sunny(to_sun: DVec3) -> Environment {
    Environment {
        sun_direction: to_sun.normalize(),
        sun_color: [0.8; 3],
        ambient_color: [0.2; 3],
        shadows: Some(SunShadows { resolution_px: 1024, ..SunShadows::default() }),
        ..plain()
    }
}

/// Returns shadows with maps that a software driver draws quickly.
pub fn small_maps() -> Option<SunShadows> {
    Some(SunShadows { resolution_px: 512, ..SunShadows::default() })
}

/// Returns a double-sided drawable of a mesh.
pub fn solid(mesh: Mesh) -> Drawable {
    Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material { double_sided: true, ..Material::default() })
}

/// Returns a double-sided box.
pub fn cuboid(min: DVec3, max: DVec3) -> Drawable {
    solid(Mesh::cuboid(&Aabb { min, max }))
}

/// Returns a square at height 0 around the origin.
pub fn ground(half_m: f64) -> Drawable {
    solid(Mesh::rectangle(DVec3::new(-half_m, -half_m, 0.0), DVec3::X * 2.0 * half_m, DVec3::Y * 2.0 * half_m))
}

/// Returns the distance along a ray to a box, in lengths of `along`; `None` if the ray misses it.
pub fn meets(from: DVec3, along: DVec3, bounds: &Aabb) -> Option<f64> {
    let (a, b) = ((bounds.min - from) / along, (bounds.max - from) / along);
    let (enters, leaves) = (a.min(b).max_element(), a.max(b).min_element());
    (enters <= leaves && leaves > 1e-6).then_some(enters.max(0.0))
}

/// Returns the origin and direction, in the world, of the ray through a pixel's center.
pub fn ray(camera: &CullCamera, x: u32, y: u32) -> (DVec3, DVec3) {
    let [width, height] = camera.viewport_px.map(f64::from);
    let clip =
        DVec4::new((f64::from(x) + 0.5) / width * 2.0 - 1.0, 1.0 - (f64::from(y) + 0.5) / height * 2.0, 0.5, 1.0);
    let p = camera.clip_from_eye.inverse() * clip;
    let world_from_eye = camera.eye_from_world.inverse();
    (world_from_eye.translation, world_from_eye.transform_vector3(p.truncate() / p.w).normalize())
}

/// Compares the shadow on the ground with rays towards the sun, pixel by pixel.
///
/// Pixels within the reach of filter and bias around an edge are not compared. `hiders` cover pixels and cast no shadow.
/// Returns the numbers of pixels compared in shadow and in sunlight.
pub fn check(
    picture: &RgbaImage,
    shadows: &StageShadows,
    camera: &CullCamera,
    [casters, hiders]: [&[Aabb]; 2],
    to_sun: DVec3,
) -> (u32, u32) {
    let cascades = &shadows.cascades;
    let is_dark = |at: DVec3| casters.iter().any(|b| meets(at, to_sun, b).is_some());
    let height = to_sun.normalize().z;
    let lit = srgb(0.2 + 0.8 * height);
    let (mut dark_count, mut lit_count) = (0, 0);
    for (x, y, pixel) in picture.enumerate_pixels() {
        let (eye, along) = ray(camera, x, y);
        let length = -eye.z / along.z;
        let at = eye + along * length;
        let is_hidden = |b: &Aabb| meets(eye, along, b).is_some_and(|l| l < length);
        if length <= 0.0 || at.abs().max_element() > 190.0 || casters.iter().chain(hiders).any(is_hidden) {
            continue;
        }
        let depth = -camera.eye_from_world.transform_point3(at).z;
        let texel_m = cascades.iter().rfind(|c| c.depths_m[0] <= depth).map_or(0.0, |c| c.texel_m);
        let pixel_m = length / 192.0 / along.z.abs().max(0.05);
        let across = to_sun.cross(DVec3::Z).normalize() * (pixel_m + 4.0 * texel_m);
        let along = to_sun.with_z(0.0).normalize() * (pixel_m + 5.5 * texel_m / height);
        let around = (0..16)
            .map(|i| f64::from(i) * std::f64::consts::FRAC_PI_8)
            .map(|a| at + across * a.cos() + along * a.sin());
        let expected = is_dark(at);
        if around.into_iter().any(|p| is_dark(p) != expected) {
            continue;
        }
        let wanted = if expected { srgb(0.2) } else { lit };
        assert!(pixel.0[0].abs_diff(wanted) <= 2, "({x}, {y}) at {at}: {:?}, not {wanted}", pixel.0);
        *(if expected { &mut dark_count } else { &mut lit_count }) += 1;
    }
    (dark_count, lit_count)
}

/// Returns the bounds of the tower, which casts the shadow.
pub fn tower() -> Aabb {
    Aabb { min: DVec3::new(-4.0, -4.0, 0.0), max: DVec3::new(4.0, 4.0, 20.0) }
}
