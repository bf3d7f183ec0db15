//! Colours of splats that change with the direction: pixels against harmonics that are computed by their definition.

use glam::{DAffine3, DMat3, DVec3, Quat};
use kit::rig::{Rig, camera, rig};
use terrane::cull::CullCamera;
use terrane::gpu::{CompileBudget, CompileOperation};
use terrane::math::color::{linear_from_srgb, srgb_from_linear};
use terrane::scene::{AlphaMode, Drawable, Geometry, Material, Node, Page, Scene, SplatHarmonics, Splats};

use super::{black, cloud, drawn, splat};

const SIDE: u32 = 16;
/// Opaque, and so large that the middle of the picture has its colour.
const SIGMA_M: f32 = 5.0;

/// Returns the associated Legendre polynomial, with the Condon-Shortley phase.
fn legendre(l: u32, m: u32, x: f64) -> f64 {
    let mut first = (1..=m).fold(1.0, |p, k| -p * f64::from(2 * k - 1) * (1.0 - x * x).sqrt());
    if l == m {
        return first;
    }
    let mut second = x * f64::from(2 * m + 1) * first;
    for k in m + 2..=l {
        let third = (x * f64::from(2 * k - 1) * second - f64::from(k + m - 1) * first) / f64::from(k - m);
        (first, second) = (second, third);
    }
    second
}

/// Returns the real spherical harmonic of a degree and an order.
fn harmonic(l: u32, order: i32, d: DVec3) -> f64 {
    let m = order.unsigned_abs();
    let factorial = |n: u32| (1..=n).map(f64::from).product::<f64>();
    let norm = (f64::from(2 * l + 1) / (4.0 * std::f64::consts::PI) * factorial(l - m) / factorial(l + m)).sqrt();
    let (azimuth, legendre) = (d.y.atan2(d.x), legendre(l, m, d.z));
    let angle = f64::from(m) * azimuth;
    norm * legendre
        * match order {
            0 => 1.0,
            1.. => 2f64.sqrt() * angle.cos(),
            _ => 2f64.sqrt() * angle.sin(),
        }
}

/// Returns degrees and orders in the order of coefficients.
fn orders(degree: u8) -> Vec<(u32, i32)> {
    (1..=i32::from(degree)).flat_map(|l| (-l..=l).map(move |m| (l as u32, m))).collect()
}

/// Returns a cloud of a splat in the origin with a colour and coefficients.
fn seen(color: [f32; 3], degree: u8, is_linear: bool, coefficients: &[[f32; 3]]) -> Drawable {
    let mut harmonics = SplatHarmonics::new(degree, is_linear);
    harmonics.push(color, coefficients);
    let displayed = color.map(|c| if is_linear { srgb_from_linear(f64::from(c).clamp(0.0, 1.0)) as f32 } else { c });
    let one = splat([0.0; 3], [SIGMA_M; 3], Quat::IDENTITY, [displayed[0], displayed[1], displayed[2], 1.0]);
    let splats = Splats::new(vec![one]).with_harmonics(harmonics).unwrap();
    Drawable::new(
        Geometry::Splats(splats.into()),
        Material { alpha: AlphaMode::Blend, unlit: true, ..Material::default() },
    )
}

/// Returns a camera that looks along a direction at the origin from 2 m.
fn along(direction: DVec3) -> CullCamera {
    camera([SIDE; 2], -2.0 * direction, DVec3::ZERO, direction.any_orthonormal_vector())
}

/// Returns the displayed colour of the middle, 0 to 1.
fn middle(rig: &mut Rig, node: Node, camera: &CullCamera) -> [f64; 3] {
    let scene = rig.scene(node);
    let picture = rig.picture(&scene, camera, &black());
    rig.release(scene);
    let pixel = picture.get_pixel(SIDE / 2, SIDE / 2);
    [0, 1, 2].map(|k| f64::from(pixel[k]) / 255.0)
}

fn is_near(got: [f64; 3], expected: [f64; 3], what: impl std::fmt::Debug) {
    for (got, expected) in got.into_iter().zip(expected) {
        assert!((got - expected).abs() < 2.5 / 255.0, "{what:?}: {got}, expected {expected}");
    }
}

fn directions() -> Vec<DVec3> {
    let axes = DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]);
    axes.chain([DVec3::new(0.6, -0.5, 0.4).normalize(), DVec3::new(-0.3, 0.7, -0.8).normalize()]).collect()
}

#[test]
fn each_harmonic_is_seen_from_its_directions() {
    let Some(mut rig) = rig("harmonics of splats") else { return };
    for degree in 1..=3u8 {
        let orders = orders(degree);
        // Three coefficients in each picture, one a channel, of those that the lower degree lacks.
        let new = SplatHarmonics::coefficients_of(degree - 1)..orders.len();
        for first in new.step_by(3) {
            let mut coefficients = vec![[0.0; 3]; orders.len()];
            for (channel, coefficient) in coefficients.iter_mut().skip(first).take(3).enumerate() {
                coefficient[channel] = 0.5;
            }
            let scene = rig.scene(Node::geode(vec![seen([0.5; 3], degree, false, &coefficients)]));
            for direction in directions() {
                let picture = rig.picture(&scene, &along(direction), &black());
                let pixel = picture.get_pixel(SIDE / 2, SIDE / 2);
                let expected = [0, 1, 2].map(|channel| {
                    let order = orders.get(first + channel);
                    0.5 + order.map_or(0.0, |(l, m)| 0.5 * harmonic(*l, *m, direction))
                });
                is_near([0, 1, 2].map(|k| f64::from(pixel[k]) / 255.0), expected, (degree, first, direction));
            }
            rig.release(scene);
        }
    }
}

#[test]
fn harmonics_turn_with_their_node() {
    let Some(mut rig) = rig("harmonics of a turned node") else { return };
    let coefficients: Vec<[f32; 3]> =
        (0..15).map(|n| [0, 1, 2].map(|k| 0.25 * (1.3 * n as f32 + 2.0 * k as f32).sin())).collect();
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 1.1);
    // Turned, mirrored, and stretched: directions follow the inverse.
    for matrix in [
        turn,
        turn * DMat3::from_diagonal(DVec3::new(-2.0, 2.0, 2.0)),
        turn * DMat3::from_diagonal(DVec3::new(1.0, 3.0, 1.0)),
    ] {
        let direction = DVec3::new(0.2, 0.9, -0.3).normalize();
        let in_cloud = (matrix.inverse() * direction).normalize();
        let expected = [0, 1, 2].map(|k| {
            let terms = orders(3).into_iter().zip(&coefficients);
            terms.fold(0.5, |sum, ((l, m), coefficient)| sum + f64::from(coefficient[k]) * harmonic(l, m, in_cloud))
        });
        let cloud = Node::geode(vec![seen([0.5; 3], 3, false, &coefficients)]);
        let node = Node::transform(DAffine3::from_mat3(matrix), vec![cloud]);
        is_near(middle(&mut rig, node, &along(direction)), expected, matrix);
    }
    // With parallel rays, a splat beside the middle is seen in the same direction.
    let mut parallel = along(DVec3::NEG_Z);
    parallel.clip_from_eye = glam::dcamera::rh::proj::directx::orthographic(-1.0, 1.0, -1.0, 1.0, 100.0, 0.1);
    let beside = DAffine3::from_translation(DVec3::new(0.5, -0.5, 0.0));
    let node =
        Node::transform(beside, vec![Node::geode(vec![seen([0.5; 3], 1, false, &[[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]])])]);
    is_near(middle(&mut rig, node, &parallel), [0.5, 0.5 - 0.5 * 0.488_602_5, 0.5], "parallel rays");
}

#[test]
fn harmonics_begin_at_the_whole_colour_and_end_at_black() {
    let Some(mut rig) = rig("colours with harmonics") else { return };
    let y = 0.488_602_5f32;
    // Seen along z, the second coefficient brings a colour above 1 and one below 0 into the range; the last one stays black.
    let back = [[0.0; 3], [-0.5 / y, 0.75 / y, 0.25 / y]];
    let node = Node::geode(vec![seen([1.25, -0.25, -0.5], 1, false, &back)]);
    is_near(middle(&mut rig, node, &along(DVec3::Z)), [0.75, 0.5, 0.0], "beyond");
    // Linear colours are added to as they are.
    let node = Node::geode(vec![seen([0.25, 0.5, 1.25], 1, true, &[[0.0; 3], [0.25 / y, -0.25 / y, -1.0 / y]])]);
    let expected = [0.5, 0.25, 0.25].map(srgb_from_linear);
    is_near(middle(&mut rig, node, &along(DVec3::Z)), expected, "linear");
    // A material's factor is one of linear light.
    let mut tinted = seen([0.5; 3], 1, false, &[[0.0; 3], [0.25 / y; 3]]);
    tinted.material.base_color = [0.5, 1.0, 0.0, 1.0];
    let expected = [0.5, 1.0, 0.0].map(|factor| srgb_from_linear(factor * linear_from_srgb(0.75)));
    is_near(middle(&mut rig, Node::geode(vec![tinted]), &along(DVec3::Z)), expected, "tinted");
}

#[test]
fn harmonics_count_as_memory() {
    let Some(mut rig) = rig("memory of harmonics") else { return };
    let before = rig.ctx.bytes_in_use();
    for (degree, bytes) in [(1, 16), (2, 32), (3, 52)] {
        let mut harmonics = SplatHarmonics::new(degree, false);
        (0..100).for_each(|_| harmonics.push([0.5; 3], &[[0.1; 3]]));
        let one = splat([0.0; 3], [0.1; 3], Quat::IDENTITY, [1.0; 4]);
        let splats = Splats::new(vec![one; 100]).with_harmonics(harmonics).unwrap();
        assert_eq!(splats.size_bytes(), 100 * (36 + 12 + bytes));
        let mut drawable = cloud(vec![one]);
        drawable.geometry = Geometry::Splats(splats.into());
        let compiled = rig.compile(vec![drawable]);
        // Splats, their centres, one order, and harmonics.
        assert_eq!((compiled.bytes, rig.ctx.bytes_in_use() - before), (100 * (52 + bytes), 100 * (52 + bytes)));
        rig.ctx.release(&compiled.slots);
        rig.ctx.flush_released();
    }
    assert_eq!(rig.ctx.bytes_in_use(), before);
}

#[test]
fn large_cloud_is_uploaded_over_several_frames() {
    let Some(mut rig) = rig("slices of splats") else { return };
    // The last splat is seen, with its harmonics; the others are behind the eye.
    let mut harmonics = SplatHarmonics::new(3, false);
    let hidden = splat([0.0, 0.0, -50.0], [0.1; 3], Quat::IDENTITY, [1.0; 4]);
    let mut list = vec![hidden; 4999];
    list.push(splat([0.0; 3], [SIGMA_M; 3], Quat::IDENTITY, [0.0, 0.0, 0.0, 1.0]));
    (0..4999).for_each(|_| harmonics.push([1.0; 3], &[]));
    harmonics.push([0.0; 3], &[[0.0; 3], [1.0, 0.0, 0.5]]);
    let splats = Splats::new(list).with_harmonics(harmonics).unwrap();
    let mut drawable = cloud(vec![hidden]);
    drawable.geometry = Geometry::Splats(splats.into());
    let mut page = Page::from_node(Node::geode(vec![drawable])).unwrap();
    rig.ctx.compile(CompileOperation { ticket: 1000, drawables: page.take_drawables() });
    let budget = CompileBudget { bytes: 40_000, ..CompileBudget::UNLIMITED };
    let (mut calls, mut sum) = (0, 0);
    while rig.ctx.pending_compiles() > 0 {
        let stats = rig.ctx.run_compiles(&budget);
        assert!(stats.bytes > 0 && stats.bytes <= budget.bytes, "{} bytes in a call", stats.bytes);
        (calls, sum) = (calls + 1, sum + stats.bytes);
    }
    assert!(calls >= 11 && sum == 5000 * (36 + 52), "{sum} bytes in {calls} calls");
    let compiled = rig.ctx.take_compiled().remove(0);
    assert!(compiled.errors.is_empty(), "{:?}", compiled.errors);
    page.set_draw_slots(0, compiled.slots);
    let mut scene = Scene::new();
    scene.add_root(page);
    let picture = rig.picture(&scene, &along(DVec3::Z), &black());
    rig.release(scene);
    let [r, g, b, _] = picture.get_pixel(SIDE / 2, SIDE / 2).0;
    let red = (255.0f64 * 0.488_602_5).round() as u8;
    assert!(r.abs_diff(red) < 3 && g == 0 && b.abs_diff(red / 2) < 3, "{r} {g} {b}");
}

#[test]
fn clouds_of_degree_0_are_drawn_beside_those_with_harmonics() {
    let Some(mut rig) = rig("degrees side by side") else { return };
    let left = cloud(vec![splat([-0.6, 0.0, 0.0], [0.1; 3], Quat::IDENTITY, [1.0, 0.5, 0.0, 1.0])]);
    let y = 0.488_602_5f32;
    let mut harmonics = SplatHarmonics::new(2, false);
    harmonics.push([0.0; 3], &[[0.0; 3], [0.0, -0.5 / y, -1.0 / y]]);
    let right = splat([0.6, 0.0, 0.0], [0.1; 3], Quat::IDENTITY, [0.0, 0.0, 0.0, 1.0]);
    let right = Splats::new(vec![right]).with_harmonics(harmonics).unwrap();
    let right = Drawable::new(Geometry::Splats(right.into()), left.material.clone());
    let picture = drawn(&mut rig, vec![left, right], &kit::rig::unit_camera(64), &black());
    let at = |x: u32| picture.get_pixel(x, 32).0;
    let ([r, g, b, _], [none, half, whole, _]) = (at(13), at(51));
    assert!(r > 245 && g.abs_diff(127) < 8 && b == 0, "{:?}", at(13));
    assert!(none == 0 && half.abs_diff(127) < 8 && whole > 245, "{:?}", at(51));
}
