//! Gaussian splats: their pixels against the formula, their order, depth and memory.

mod harmonics;

use std::sync::Arc;

use glam::{DVec3, Quat, Vec2};
use image::RgbaImage;
use kit::rig::{Rig, camera, plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::cull::CullCamera;
use terrane::math::color::{linear_from_srgb8, srgb_from_linear};
use terrane::scene::{AlphaMode, Drawable, Environment, Geometry, Material, Node, Sky, Splat, Splats};

const SIDE: u32 = 64;
/// Pixels of a metre in the plane z = 0 of the unit camera.
const PX_PER_M: f32 = 32.0;
/// The variance that the renderer adds on screen.
const PIXEL_VARIANCE: f32 = 0.3;

fn black() -> Environment {
    Environment { sky: Sky::Background([0; 3]), ..plain() }
}

fn splat(position: [f32; 3], scale: [f32; 3], rotation: Quat, color: [f32; 4]) -> Splat {
    Splat::new(position, scale, rotation.to_array(), color).unwrap()
}

fn cloud(list: Vec<Splat>) -> Drawable {
    let material = Material { alpha: AlphaMode::Blend, unlit: true, ..Material::default() };
    Drawable::new(Geometry::Splats(Arc::new(Splats::new(list))), material)
}

fn drawn(rig: &mut Rig, drawables: Vec<Drawable>, camera: &CullCamera, environment: &Environment) -> RgbaImage {
    let scene = rig.scene(Node::geode(drawables));
    let picture = rig.picture(&scene, camera, environment);
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    picture
}

/// Checks the red of each pixel of a white splat against the alpha that a function gives for an offset from the middle.
fn is_gaussian(picture: &RgbaImage, alpha: impl Fn(Vec2) -> f32) {
    let mut covered = 0;
    for (x, y, pixel) in picture.enumerate_pixels() {
        let offset = Vec2::new(x as f32 + 0.5 - 0.5 * SIDE as f32, 0.5 * SIDE as f32 - y as f32 - 0.5);
        let expected = alpha(offset);
        let got = linear_from_srgb8(pixel[0]) as f32;
        covered += u32::from(pixel[0] > 0);
        // Two steps of a byte, and the last fragments before the end.
        assert!((got - expected).abs() < 0.01 + 0.015 * expected, "{x} {y}: {got}, expected {expected}");
        assert!(pixel[0] == pixel[1] && pixel[1] == pixel[2], "grey");
    }
    assert!(covered > 50, "{covered} pixels");
}

#[test]
fn pixels_of_a_splat_are_a_gaussian() {
    let Some(mut rig) = rig("pixels of a splat") else { return };
    let camera = unit_camera(SIDE);
    // A ball, whose size in depth has no effect.
    let ball = splat([0.0; 3], [0.15, 0.15, 1.0], Quat::IDENTITY, [1.0, 1.0, 1.0, 0.8]);
    let variance = (0.15 * PX_PER_M).powi(2) + PIXEL_VARIANCE;
    let picture = drawn(&mut rig, vec![cloud(vec![ball])], &camera, &black());
    let of_ball = |offset: Vec2| match offset.length_squared() / variance {
        square if square > 9.0 => 0.0,
        square => 0.8 * (-0.5 * square).exp(),
    };
    is_gaussian(&picture, of_ball);
    // An exposure and tone mapping leave it as it is.
    let exposed = Environment { exposure: Some(3.0), ..black() };
    let again = drawn(&mut rig, vec![cloud(vec![ball])], &camera, &exposed);
    assert_eq!(picture, again);
    // A needle, turned by its rotation and once more around the axis of the view.
    let angle = 0.6f32;
    let needle = splat([0.0; 3], [0.05, 0.05, 0.3], Quat::from_rotation_y(1.570_796_4), [1.0; 4]);
    let needle = vec![cloud(vec![needle])];
    let turned = glam::DAffine3::from_rotation_z(angle.into());
    let scene = rig.scene(Node::transform(turned, vec![Node::geode(needle)]));
    let picture = rig.picture(&scene, &camera, &black());
    rig.release(scene);
    let [long, short] = [0.3f32, 0.05].map(|scale| (scale * PX_PER_M).powi(2) + PIXEL_VARIANCE);
    let along = Vec2::from_angle(angle);
    is_gaussian(&picture, |offset| {
        let square = offset.dot(along).powi(2) / long + offset.dot(along.perp()).powi(2) / short;
        if square > 9.0 { 0.0 } else { (-0.5 * square).exp() }
    });
}

#[test]
fn splats_are_blended_from_back_to_front_from_both_sides() {
    let Some(mut rig) = rig("order of splats") else { return };
    let flat = |z: f32, color| splat([0.0, 0.0, z], [0.3, 0.3, 0.001], Quat::IDENTITY, color);
    // In the order of the list, one of the views would be wrong.
    let list =
        vec![flat(-0.2, [0.0, 0.0, 1.0, 0.75]), flat(0.2, [1.0, 0.0, 0.0, 0.75]), flat(0.0, [0.0, 1.0, 0.0, 0.75])];
    let scene = rig.scene(Node::geode(vec![cloud(list)]));
    let turned = camera([SIDE; 2], DVec3::Z * -10.0, DVec3::ZERO, DVec3::Y);
    let behind = CullCamera { eye_from_world: turned.eye_from_world, ..unit_camera(SIDE) };
    let views = [(unit_camera(SIDE), [0.75, 0.1875, 0.046875]), (behind, [0.046875, 0.1875, 0.75])];
    // The order follows the eye, there and back.
    for (camera, expected) in [&views[0], &views[1], &views[0]] {
        let picture = rig.picture(&scene, camera, &black());
        let middle = picture.get_pixel(SIDE / 2, SIDE / 2);
        for (got, wanted) in middle.0.iter().zip(expected) {
            let wanted = srgb_from_linear(*wanted) * 255.0;
            assert!((f64::from(*got) - wanted).abs() < 4.0, "{middle:?}, expected {expected:?}");
        }
    }
    rig.release(scene);
}

#[test]
fn splats_are_hidden_by_what_is_nearer_and_tinted_by_their_material() {
    let Some(mut rig) = rig("splats and depth") else { return };
    let white = || cloud(vec![splat([0.0; 3], [0.4; 3], Quat::IDENTITY, [1.0; 4])]);
    let wall = |z: f32| quad([0.5, 0.0, z], [0.5, 1.0], [0.0, 0.0, 1.0, 1.0]);
    let camera = unit_camera(SIDE);
    let at = |picture: &RgbaImage, x: u32| picture.get_pixel(x, SIDE / 2).0;
    let before = drawn(&mut rig, vec![white(), wall(0.5)], &camera, &black());
    assert!(at(&before, SIDE / 2 + 3)[0] == 0 && at(&before, SIDE / 2 - 3)[0] > 240, "the wall hides its half");
    let after = drawn(&mut rig, vec![white(), wall(-0.5)], &camera, &black());
    assert!(at(&after, SIDE / 2 + 3)[0] > 240, "the wall is behind");
    let mut red = white();
    red.material.base_color = [1.0, 0.0, 0.0, 0.5];
    let tinted = drawn(&mut rig, vec![red], &camera, &black());
    let [r, g, b, _] = at(&tinted, SIDE / 2);
    assert!((186..=190).contains(&r) && g == 0 && b == 0, "{:?}", at(&tinted, SIDE / 2));
    // A splat behind the eye is not drawn.
    let behind = cloud(vec![splat([0.0, 0.0, 10.5], [0.4; 3], Quat::IDENTITY, [1.0; 4])]);
    let nothing = drawn(&mut rig, vec![behind], &camera, &black());
    assert!(nothing.pixels().all(|pixel| pixel.0[..3] == [0; 3]));
}

#[test]
fn memory_of_splats_is_counted_and_freed() {
    let Some(mut rig) = rig("memory of splats") else { return };
    let before = rig.ctx.bytes_in_use();
    let one = splat([0.0; 3], [0.1; 3], Quat::IDENTITY, [1.0; 4]);
    let cloud = cloud(vec![one; 1000]);
    assert_eq!(cloud.size_bytes(), 48_000);
    let scene = rig.scene(Node::geode(vec![cloud]));
    // Splats, their centres and one order.
    assert_eq!(rig.ctx.bytes_in_use() - before, 1000 * (36 + 12 + 4));
    let stats = rig.draw(&scene, &unit_camera(SIDE), &black());
    assert_eq!((stats.points, stats.draw_calls), (1000, 1));
    rig.release(scene);
    assert_eq!(rig.ctx.bytes_in_use(), before);
    let compiled = rig.compile(vec![self::cloud(Vec::new())]);
    assert!(compiled.errors[0].contains("no splats"), "{:?}", compiled.errors);
}
