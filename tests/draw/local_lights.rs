//! Local lights: they light only what is below their node, with every shader.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::frames::{assert_picture, differ, keep, pixel, srgb};
use kit::rig::{Rig, camera, plain, rig, unit_camera};
use kit::shadows::small_maps;
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::scene::{
    CameraEnvironment, CameraNode, Clearcoat, Dielectric, Drawable, Environment, LocalLights, Material, Mesh,
    MetallicRoughness, Node, NodeKind, ReferenceFrame, RenderOrder,
};
use terrane::state::{Attribute, Fog, FogMode, Light, Mode, StateSet, StateValue};

const SIDE: u32 = 64;

/// Returns an environment in which nothing but local lights shines.
fn dark() -> Environment {
    Environment { sun_color: [0.0; 3], ambient_color: [0.0; 3], ..plain() }
}

/// Returns a light that shines along negative z.
fn from_front(color: [f32; 3]) -> Light {
    Light { position: [0.0, 0.0, 1.0, 0.0], diffuse: color, ..Light::default() }
}

/// Returns a lamp without attenuation.
fn lamp(position: [f64; 3], range_m: f32) -> Light {
    let [x, y, z] = position;
    Light { position: [x, y, z, 1.0], range_m, ..Light::default() }
}

fn lit_by(lights: Vec<Light>, children: Vec<Node>) -> Node {
    Node { children, ..Node::new(NodeKind::LocalLights(LocalLights { lights })) }
}

/// Returns a lit square of half a metre around a point, facing +z.
fn square(x: f32, y: f32) -> Drawable {
    let mut drawable = quad([x, y, 0.0], [0.4, 0.4], [1.0; 4]);
    drawable.material.unlit = false;
    drawable
}

fn with_material(material: &Material) -> Drawable {
    let mut drawable = square(0.0, 0.0);
    drawable.material = material.clone();
    drawable
}

fn at(x: f32, y: f32) -> Node {
    Node::geode(vec![square(x, y)])
}

/// Draws nodes in the dark. The image spans -1 to 1.
fn draw(rig: &mut Rig, nodes: Vec<Node>) -> RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &dark());
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    picture
}

/// Returns the colours of squares in the four quarters of the image: left and right above, then below.
fn quarters(picture: &RgbaImage) -> [[u8; 3]; 4] {
    [(16, 16), (48, 16), (16, 48), (48, 48)].map(|(x, y)| pixel(picture, x, y))
}

fn four() -> [Node; 4] {
    [at(-0.5, 0.5), at(0.5, 0.5), at(-0.5, -0.5), at(0.5, -0.5)]
}

const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const YELLOW: [u8; 3] = [255, 255, 0];
const BLACK: [u8; 3] = [0; 3];

#[test]
fn lights_shine_below_their_node_alone() {
    let Some(mut rig) = rig("lights_shine_below_their_node_alone") else { return };
    let (red, green) = (from_front([1.0, 0.0, 0.0]), from_front([0.0, 1.0, 0.0]));
    let [a, b, c, d] = four();
    let picture = draw(&mut rig, vec![lit_by(vec![red], vec![a]), b, lit_by(vec![green], vec![c]), d]);
    assert_eq!(quarters(&picture), [RED, BLACK, GREEN, BLACK]);
    // Nodes inside each other add their lights; the same holds for several lights of a node.
    let [a, b, c, d] = four();
    let inner = lit_by(vec![green], vec![b, lit_by(vec![], vec![c])]);
    let picture = draw(&mut rig, vec![lit_by(vec![red], vec![a, inner]), lit_by(vec![red, green], vec![d])]);
    assert_eq!(quarters(&picture), [RED, YELLOW, YELLOW, YELLOW]);
}

/// The same lights light each square: of the matte and the metallic-roughness model, under the fixed function, with several
/// vertices and under a state set that blends or fades.
#[test]
fn every_shader_is_lit() {
    let Some(mut rig) = rig("every_shader_is_lit") else { return };
    let surface = Material { metallic_roughness: Some(MetallicRoughness::default()), ..Material::default() };
    let fog = Fog { mode: FogMode::Exp { density_per_m: 0.0 }, color: [0.0; 3], is_displayed: false };
    let fixed = Arc::new(StateSet::default().with(Attribute::Fog(fog)));
    let blended = Arc::new(StateSet::default().with_mode(Mode::Blend, StateValue::ON));
    let half = from_front([0.5; 3]);
    let mut seen = |node: Node| {
        let both = lit_by(vec![half, Light { diffuse: [0.0; 3], ambient: [0.0, 0.2, 0.0], ..half }], vec![node]);
        pixel(&draw(&mut rig, vec![both]), SIDE / 2, SIDE / 2)
    };
    let matte = seen(at(0.0, 0.0));
    assert!(matte[0].abs_diff(srgb(0.5)) <= 1 && matte[1].abs_diff(srgb(0.7)) <= 1, "{matte:?}");
    assert_eq!(seen(at(0.0, 0.0).with_state_set(fixed)), matte);
    assert_eq!(seen(at(0.0, 0.0).with_state_set(blended)), matte);
    let rough = seen(Node::geode(vec![with_material(&surface)]));
    assert!((0..3).all(|i| rough[i].abs_diff(matte[i]) < 12), "a rough surface is much like a matte one: {rough:?}");
    // Glossy metal mirrors the light to the eye, and little of it elsewhere.
    let mut metal = surface;
    metal.base_color = [1.0, 0.0, 0.0, 1.0];
    if let Some(model) = &mut metal.metallic_roughness {
        (model.metallic, model.roughness) = (1.0, 0.3);
    }
    let mut mirrored = |x: f64| {
        let aside = Light { position: [x, 0.0, 1.0, 0.0], ..half };
        let lit = lit_by(vec![aside], vec![Node::geode(vec![with_material(&metal)])]);
        pixel(&draw(&mut rig, vec![lit]), SIDE / 2, SIDE / 2)
    };
    let [front, aside] = [0.0, 1.0].map(&mut mirrored);
    assert!(front[0] == 255 && front[1] < 60 && aside[0] < 60, "{front:?} {aside:?}");
}

#[test]
fn height_tiles_are_lit() {
    let Some(mut rig) = rig("height_tiles_are_lit") else { return };
    let terrain = Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 10.0, root_error_m: 1.0, textured: false };
    let (up, target) = (terrain.up(0.5, 0.5), terrain.world(0.5, 0.5, 0.0));
    let sideways = terrain.world(0.5, 0.6, 0.0) - target;
    let red = Light { position: up.extend(0.0).to_array(), ..from_front([1.0, 0.0, 0.0]) };
    let mut seen = |lights: Vec<Light>| {
        let scene = rig.scene(lit_by(lights, vec![terrain.tile(0, 0, 0)]));
        let picture = rig.picture(&scene, &camera([SIDE; 2], target + 9_000.0 * up, target, sideways), &dark());
        rig.release(scene);
        pixel(&picture, SIDE / 2, SIDE / 2)
    };
    assert_eq!(seen(vec![]), BLACK);
    let lit = seen(vec![red]);
    assert!(lit[0] > 60 && lit[1] == 0, "{lit:?}");
}

#[test]
fn lamps_end_at_their_range_and_spots_at_their_rim() {
    let Some(mut rig) = rig("lamps_end_at_their_range_and_spots_at_their_rim") else { return };
    let rig = &mut *rig;
    let wall = || {
        Node::geode(vec![{
            let mut wall = quad([0.0; 3], [1.0, 1.0], [1.0; 4]);
            wall.material.unlit = false;
            wall
        }])
    };
    // The lamp is half a metre in front of the wall; its range meets the wall in a circle of radius 0.6.
    let range_m = 0.61f32.sqrt();
    let picture = draw(rig, vec![lit_by(vec![lamp([0.0, 0.0, 0.5], range_m)], vec![wall()])]);
    keep("lamp_with_a_range", &picture);
    let share = |radius: f32| 0.5 / (0.25 + radius * radius).sqrt() * (1.0 - ((0.25 + radius * radius) / 0.61).powi(2));
    for x in SIDE / 2..SIDE {
        let radius = (x as f32 + 0.5) / 32.0 - 1.0;
        let red = f32::from(pixel(&picture, x, SIDE / 2)[0]);
        let expected = if radius < 0.6 { f32::from(srgb(share(radius).max(0.0).into())) } else { 0.0 };
        assert!((red - expected).abs() < 12.0, "{red} instead of {expected} at {radius}");
        assert!(radius < 0.6 || red == 0.0, "beyond the range");
    }
    // A cone of radius 0.5 with a sharp rim, and one that falls off from a radius of 0.25 on.
    let cone = |radius: f32| radius.atan();
    let spot = |inner: f32| Light {
        direction: [0.0, 0.0, -1.0],
        spot_cutoff: cone(0.5),
        spot_inner_cutoff: inner,
        ..lamp([0.0, 0.0, 1.0], f32::INFINITY)
    };
    let [sharp, soft] = [cone(0.5), cone(0.25)].map(|inner| draw(rig, vec![lit_by(vec![spot(inner)], vec![wall()])]));
    keep("soft_spot", &soft);
    let lit = sharp.pixels().filter(|p| p.0[0] > 0).count() as f32;
    assert!((lit / (std::f32::consts::PI * 16.0 * 16.0) - 1.0).abs() < 0.05, "{lit} pixels");
    let row = |picture: &RgbaImage| (SIDE / 2..SIDE).map(|x| pixel(picture, x, SIDE / 2)[0]).collect::<Vec<u8>>();
    let (sharp, soft) = (row(&sharp), row(&soft));
    assert!(sharp[15] > 240 && sharp[16] == 0, "{sharp:?}");
    assert!(soft[..7].iter().zip(&sharp).all(|(a, b)| a == b), "{soft:?} {sharp:?}");
    assert!(soft[8..17].is_sorted_by(|a, b| a > b) && soft[16] == 0 && soft[12] > 20, "{soft:?}");
}

#[test]
fn lights_follow_the_transforms_above() {
    let Some(mut rig) = rig("lights_follow_the_transforms_above") else { return };
    let turned = DAffine3::from_rotation_z(std::f64::consts::PI) * DAffine3::from_scale(DVec3::splat(2.0));
    // Turned around and twice as far, the lamp is between the left squares and 0.4 m in front of them. Its range stays.
    let squares = four().map(|node| Node::transform(turned.inverse(), vec![node]));
    let lit = lit_by(vec![lamp([0.25, 0.0, 0.2], 0.8)], squares.to_vec());
    let picture = draw(&mut rig, vec![Node::transform(turned, vec![lit])]);
    let green = [16, 48].map(|x| (0..SIDE).map(|y| u32::from(pixel(&picture, x, y)[1])).sum::<u32>());
    assert!(green[0] > 500 && green[1] == 0, "{green:?}");
}

#[test]
fn first_lights_shine_and_invalid_ones_are_reported() {
    let Some(mut rig) = rig("first_lights_shine_and_invalid_ones_are_reported") else { return };
    let dim = from_front([0.5 / LocalLights::MAX as f32; 3]);
    let mut lights = vec![dim; LocalLights::MAX];
    let mut seen = |lights: &[Light]| pixel(&draw(&mut rig, vec![lit_by(lights.to_vec(), vec![at(0.0, 0.0)])]), 32, 32);
    let all = seen(&lights);
    assert!(all[0].abs_diff(188) <= 1, "{all:?}");
    lights.push(from_front([1.0; 3]));
    assert_eq!(seen(&lights), all, "a light beyond the maximum");
    let broken = [Light { diffuse: [f32::NAN; 3], ..dim }, Light { range_m: 0.0, ..dim }, dim];
    let scene = rig.scene(lit_by(broken.to_vec(), vec![at(0.0, 0.0)]));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &dark());
    rig.release(scene);
    assert!((1..80).contains(&pixel(&picture, 32, 32)[0]));
    let errors = rig.renderer.take_errors();
    assert_eq!(
        errors,
        [
            "a LocalLights: light 0 does not shine: its color is not finite",
            "a LocalLights: light 1 does not shine: its range is not positive"
        ]
    );
}

/// Leaves without local lights share their calls whether or not others have some.
#[test]
fn lights_do_not_split_the_calls_of_other_leaves() {
    let Some(mut rig) = rig("lights_do_not_split_the_calls_of_other_leaves") else { return };
    let grid = || (0..64u8).map(|i| at(f32::from(i % 8) / 4.0 - 0.9, f32::from(i / 8) / 4.0 - 0.9));
    let mut calls = |lit: usize| {
        let lit = (0..lit).map(|i| lit_by(vec![from_front([1.0; 3])], vec![at(i as f32 / 8.0, 0.1)]));
        let scene = rig.scene(Node::group(grid().step_by(2).chain(lit).chain(grid().skip(1).step_by(2)).collect()));
        let stats = rig.draw(&scene, &unit_camera(SIDE), &dark());
        rig.release(scene);
        stats.draw_calls
    };
    assert_eq!([calls(1) - calls(0), calls(3) - calls(0)], [1, 3]);
}

#[test]
fn cameras_inside_the_view_see_the_lights_where_they_are() {
    let Some(mut rig) = rig("cameras_inside_the_view_see_the_lights_where_they_are") else { return };
    let rig = &mut *rig;
    let own = camera([96, 96], DVec3::new(1.5, -1.0, 4.0), DVec3::new(0.2, 0.1, 0.0), DVec3::Y);
    let outer = camera([96, 96], DVec3::new(-30.0, 4.0, 20.0), DVec3::new(-40.0, 0.0, 10.0), DVec3::Z);
    let nested = |environment: CameraEnvironment, order, children: Vec<Node>| {
        let camera = CameraNode {
            frame: ReferenceFrame::Absolute,
            view: own.eye_from_world,
            projection: Some(own.clip_from_eye),
            environment,
            ..CameraNode::new(order)
        };
        Node::camera(camera, children)
    };
    let lit = || lit_by(vec![lamp([0.6, 0.5, 0.7], 2.0)], four().to_vec());
    let mut drawn = |node: Node, from| {
        let scene = rig.scene(node);
        let picture = rig.picture(&scene, from, &dark());
        rig.release(scene);
        picture
    };
    let expected = drawn(lit(), &own);
    assert!(expected.pixels().any(|p| p.0[1] > 200));
    let (nested_order, after) = (RenderOrder::Nested, RenderOrder::PostRender(0));
    for (order, environment) in [
        (nested_order, CameraEnvironment::Inherited),
        (nested_order, CameraEnvironment::Light),
        (after, CameraEnvironment::Inherited),
    ] {
        let inside = drawn(nested(environment.clone(), order, vec![lit()]), &outer);
        assert_eq!(differ(&inside, &expected, 1), 0, "{order:?} {environment:?}");
    }
    // A nested camera keeps the lights above it, but not a camera with a separate stage.
    let below = |order| {
        let camera = nested(CameraEnvironment::Inherited, order, four().to_vec());
        lit_by(vec![lamp([0.6, 0.5, 0.7], 2.0)], vec![camera])
    };
    assert_eq!(differ(&drawn(below(nested_order), &outer), &expected, 1), 0);
    assert!(drawn(below(after), &outer).pixels().all(|p| p.0[1] == 0));
}

/// Local lights cast no shadows, and what they light still casts and receives those of the sun.
#[test]
fn lit_drawables_cast_and_receive_the_shadows_of_the_sun() {
    let Some(mut rig) = rig("lit_drawables_cast_and_receive_the_shadows_of_the_sun") else { return };
    let scene = |lights: Vec<Light>| {
        let ground = Mesh::rectangle(DVec3::new(-5.0, -5.0, 0.0), 10.0 * DVec3::X, 10.0 * DVec3::Y);
        let roof = Mesh::rectangle(DVec3::new(-1.0, -1.0, 1.0), 2.0 * DVec3::X, 2.0 * DVec3::Y);
        let drawables = [ground, roof].map(|mesh| Drawable::new(mesh.into(), Material::default()));
        lit_by(lights, vec![Node::geode(drawables.to_vec())])
    };
    let view = camera([96, 96], DVec3::new(0.0, -8.0, 4.0), DVec3::ZERO, DVec3::Z);
    let sunny = Environment {
        sun_direction: DVec3::new(-0.8, 0.0, 0.6),
        sun_color: [0.5; 3],
        ambient_color: [0.0; 3],
        shadows: small_maps(),
        ..plain()
    };
    let mut drawn = |lights| {
        let scene = rig.scene(scene(lights));
        let picture = rig.picture(&scene, &view, &sunny);
        rig.release(scene);
        picture
    };
    let blue = from_front([0.0, 0.0, 0.4]);
    let [plain, lit] = [vec![], vec![blue]].map(&mut drawn);
    keep("lit_in_shadow", &lit);
    let is_shadow = |p: &image::Rgba<u8>| p.0[0] == 0;
    let shadow = plain.pixels().filter(|p| is_shadow(p)).count();
    assert!(shadow > 100, "{shadow}");
    for (before, after) in plain.pixels().zip(lit.pixels()) {
        assert_eq!(before.0[..2], after.0[..2]);
        assert!(!is_shadow(before) || after.0[2] > 160, "{after:?}");
    }
}

/// A coat mirrors local lights, over a base that reflects nothing.
#[test]
fn clearcoat_mirrors_local_lights() {
    let Some(mut rig) = rig("clearcoat_mirrors_local_lights") else { return };
    let mut coated = |strength: f32| {
        let surface = MetallicRoughness {
            dielectric: Dielectric { ior: 1.0, ..Dielectric::default() },
            clearcoat: Clearcoat { strength, roughness: 0.3, ..Clearcoat::default() },
            ..MetallicRoughness::default()
        };
        let material =
            Material { base_color: [0.0, 0.0, 0.0, 1.0], metallic_roughness: Some(surface), ..Material::default() };
        let node = Node::geode(vec![with_material(&material)]);
        let blue = from_front([0.0, 0.0, 0.5]);
        pixel(&draw(&mut rig, vec![lit_by(vec![blue], vec![node])]), SIDE / 2, SIDE / 2)
    };
    assert_eq!(coated(0.0), [0; 3]);
    let [red, green, blue] = coated(1.0);
    assert!(red == 0 && green == 0 && blue > 100, "{red} {green} {blue}");
}

/// Draws a room at night: a warm lamp on the left, a blue spot on the right, balls of a matte, a glossy and a metallic
/// material.
#[test]
fn room_with_a_lamp_and_a_spot() {
    let Some(mut rig) = rig("room_with_a_lamp_and_a_spot") else { return };
    let surface = |color: [f32; 3], metallic, roughness| Material {
        base_color: [color[0], color[1], color[2], 1.0],
        metallic_roughness: Some(MetallicRoughness { metallic, roughness, ..MetallicRoughness::default() }),
        ..Material::default()
    };
    let grey = Material { base_color: [0.6, 0.6, 0.6, 1.0], ..Material::default() };
    let floor = Mesh::rectangle(DVec3::new(-4.0, -3.0, 0.0), 8.0 * DVec3::X, 6.0 * DVec3::Y);
    let wall = Mesh::rectangle(DVec3::new(-4.0, 3.0, 0.0), 8.0 * DVec3::X, 4.0 * DVec3::Z);
    let ball = |x: f64, material| Drawable::new(Mesh::sphere(DVec3::new(x, 0.0, 0.7), 0.7, 48).into(), material);
    let drawables = vec![
        Drawable::new(floor.into(), surface([0.6; 3], 0.0, 0.35)),
        Drawable::new(wall.into(), grey.clone()),
        ball(-2.0, grey),
        ball(0.0, surface([0.6, 0.1, 0.1], 0.0, 0.25)),
        ball(2.0, surface([1.0, 0.7, 0.3], 1.0, 0.35)),
    ];
    let lux = Environment::SUN_LUX.recip();
    let warm = Light {
        diffuse: [300.0 * lux, 200.0 * lux, 90.0 * lux],
        attenuation: [0.0, 0.0, 1.0],
        ..lamp([-3.0, 0.5, 2.2], 12.0)
    };
    let blue = Light {
        diffuse: [100.0 * lux, 200.0 * lux, 900.0 * lux],
        attenuation: [0.0, 0.0, 1.0],
        direction: [0.0, 0.25, -1.0],
        spot_cutoff: 0.5,
        spot_inner_cutoff: 0.35,
        ..lamp([2.0, -0.8, 3.5], f32::INFINITY)
    };
    let scene = rig.scene(lit_by(vec![warm, blue], vec![Node::geode(drawables)]));
    let night = Environment { exposure: Some(1_500.0), ..dark() };
    let view = camera([320, 160], DVec3::new(0.0, -6.5, 2.4), DVec3::new(0.0, 0.0, 0.9), DVec3::Z);
    let picture = rig.picture(&scene, &view, &night);
    rig.release(scene);
    assert_picture("local_lights", &picture);
}
