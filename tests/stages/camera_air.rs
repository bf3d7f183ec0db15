//! Air for cameras in the graph: each sees it from its own eye, if it asks for it. Needs a GPU; a software adapter
//! suffices.

use std::sync::Arc;

use glam::DVec3;
use image::RgbaImage;
use kit::cameras::no_errors;
use kit::frames::{differ, keep};
use kit::rig::{Rig, camera, rig};
use kit::terrain::Terrain;
use terrane::cull::CullCamera;
use terrane::draw::DrawStats;
use terrane::scene::{
    CameraEnvironment, CameraNode, CameraTarget, DistanceFog, Environment, Node, NodeKind, PictureSink, ReferenceFrame,
    RenderOrder, Scene, SceneError, Sky, Water,
};

const SIZE: [u32; 2] = [256, 192];
const TERRAIN: Terrain =
    Terrain { west: 0.2, south: 0.75, width: 0.02, relief_m: 2500.0, root_error_m: 400.0, textured: true };

/// Returns a camera at one point of the terrain that looks towards another.
fn looking(size_px: [u32; 2], from: [f64; 2], above_m: f64, to: [f64; 2]) -> CullCamera {
    let [eye, target] = [TERRAIN.world(from[0], from[1], above_m), TERRAIN.world(to[0], to[1], 600.0)];
    camera(size_px, eye, target, TERRAIN.up(from[0], from[1]))
}

/// Returns the world's environment for the eye of a camera.
fn around(camera: &CullCamera) -> Environment {
    let up = TERRAIN.up(0.5, 0.5);
    let east = DVec3::Z.cross(up).normalize();
    let environment = Environment {
        sun_direction: (0.5 * up + east).normalize(),
        fog: DistanceFog { enabled: true, density_per_m: 3e-5 },
        ..Environment::default()
    };
    environment.seen_from(camera.eye_from_world.inverse().translation)
}

fn eye(camera: &CullCamera) -> DVec3 {
    camera.eye_from_world.inverse().translation
}

fn terrain(camera: &CullCamera) -> Node {
    TERRAIN.tiles_for(camera, eye(camera), 4)
}

/// Returns a camera to a texture with the view of another camera.
fn like(camera: &CullCamera, environment: CameraEnvironment) -> CameraNode {
    CameraNode { environment, ..kit::cameras::like(camera) }
}

/// Returns a main camera for tests of another one: far away, high up, with another direction.
fn elsewhere() -> CullCamera {
    looking([64, 64], [0.1, 0.9], 40_000.0, [0.1, 0.1])
}

/// Returns the image of a camera to a texture while the main camera is elsewhere.
fn drawn(rig: &mut Rig, node: CameraNode, children: Vec<Node>, main: &Environment) -> (RgbaImage, DrawStats) {
    kit::cameras::drawn(rig, node, children, &elsewhere(), main)
}

/// Returns the main image of the terrain from a camera.
fn picture(rig: &mut Rig, camera: &CullCamera, environment: &Environment) -> RgbaImage {
    kit::cameras::picture(rig, terrain(camera), camera, environment)
}

#[test]
fn camera_to_a_texture_shows_the_same_air_as_a_main_camera_there() {
    let Some(mut rig) = rig("camera_to_a_texture_shows_the_same_air_as_a_main_camera_there") else { return };
    let rig = &mut *rig;
    let main = around(&elsewhere());
    // The eyes are between mountains, high above them, and nearly in orbit with another lens.
    let wide = looking(SIZE, [0.5, 0.2], 300_000.0, [0.5, 0.8]);
    let lens = glam::dcamera::rh::proj::directx::perspective_infinite_reverse(1.6, 4.0 / 3.0, 0.1);
    for (name, camera) in [
        ("low", looking(SIZE, [0.3, 0.3], 900.0, [0.6, 0.7])),
        ("high", looking(SIZE, [0.8, 0.1], 9_000.0, [0.4, 0.6])),
        ("orbit", CullCamera { clip_from_eye: lens, ..wide }),
    ] {
        let expected = picture(rig, &camera, &around(&camera));
        let inherited = like(&camera, CameraEnvironment::Inherited);
        let (found, _) = drawn(rig, inherited, vec![terrain(&camera)], &main);
        keep(&format!("air-{name}-picture"), &expected);
        keep(&format!("air-{name}-texture"), &found);
        assert_eq!(differ(&found, &expected, 1), 0, "{name}");
        // By default there is no sky, and the air is that of another eye.
        let (plain, _) = drawn(rig, like(&camera, CameraEnvironment::Light), vec![terrain(&camera)], &main);
        keep(&format!("air-{name}-unasked"), &plain);
        assert!(differ(&plain, &expected, 8) > 10_000, "{name}");
    }
    no_errors(rig);
}

#[test]
fn camera_may_have_its_own_environment() {
    let Some(mut rig) = rig("camera_may_have_its_own_environment") else { return };
    let rig = &mut *rig;
    let camera = looking(SIZE, [0.3, 0.3], 900.0, [0.6, 0.7]);
    let main = around(&elsewhere());
    let up = TERRAIN.up(0.3, 0.3);
    let ahead = (TERRAIN.world(0.6, 0.7, 0.0) - eye(&camera)).normalize();
    let evening = Environment {
        sun_direction: (ahead + 0.1 * up).normalize(),
        fog: DistanceFog { enabled: true, density_per_m: 1.5e-4 },
        water: Some(Water::at(900.0)),
        ..around(&camera)
    };
    let expected = picture(rig, &camera, &evening);
    let own = CameraEnvironment::Own(Arc::new(evening));
    let (found, _) = drawn(rig, like(&camera, own), vec![terrain(&camera)], &main);
    keep("air-own", &found);
    assert_eq!(differ(&found, &expected, 1), 0);
    assert!(differ(&found, &picture(rig, &camera, &around(&camera)), 8) > 20_000);
    // A camera has a plain background below a main image with a sky.
    let plain = Environment { sky: Sky::Background([200, 30, 120]), ..evening };
    let expected = picture(rig, &camera, &plain);
    let own = CameraEnvironment::Own(Arc::new(plain));
    let (found, _) = drawn(rig, like(&camera, own), vec![terrain(&camera)], &main);
    assert_eq!(found.get_pixel(128, 2).0, [200, 30, 120, 255]);
    assert_eq!(differ(&found, &expected, 1), 0);
    no_errors(rig);
}

#[test]
fn camera_to_a_texture_has_no_sky_by_default() {
    let Some(mut rig) = rig("camera_to_a_texture_has_no_sky_by_default") else { return };
    let rig = &mut *rig;
    let camera = looking(SIZE, [0.3, 0.3], 900.0, [0.6, 0.7]);
    let main = Environment { water: Some(Water::at(900.0)), ..around(&elsewhere()) };
    let clear_color = Some([0.0, 1.0, 0.0, 0.25]);
    let node = CameraNode { clear_color, ..like(&camera, CameraEnvironment::default()) };
    let (empty, stats) = drawn(rig, node.clone(), vec![], &main);
    assert!(empty.pixels().all(|p| p.0 == [0, 255, 0, 64]));
    // Only the sky and water of the main image are drawn.
    assert_eq!((stats.passes, stats.draw_calls), (2, 2));
    let (found, _) = drawn(rig, node.clone(), vec![terrain(&camera)], &main);
    let cleared = found.pixels().filter(|p| p.0 == [0, 255, 0, 64]).count();
    assert!((2_000..45_000).contains(&cleared), "{cleared}");
    // With air but without a clear, the old content stays and no sky covers it.
    let asks = CameraNode { environment: CameraEnvironment::Inherited, clear_color: None, ..node };
    let (_, stats) = drawn(rig, asks, vec![], &main);
    assert_eq!((stats.passes, stats.draw_calls), (2, 2));
    no_errors(rig);
}

#[test]
fn mirror_in_a_corner_shows_its_own_air() {
    let Some(mut rig) = rig("mirror_in_a_corner_shows_its_own_air") else { return };
    let rig = &mut *rig;
    let main = looking(SIZE, [0.3, 0.3], 6_000.0, [0.6, 0.7]);
    let corner = [90, 60];
    let behind = looking(corner, [0.3, 0.3], 6_000.0, [0.2, 0.0]);
    let environment = around(&main);
    let expected = picture(rig, &behind, &environment);
    let without = picture(rig, &main, &environment);
    let mirror = |environment| CameraNode {
        frame: ReferenceFrame::Absolute,
        view: behind.eye_from_world,
        projection: Some(behind.clip_from_eye),
        viewport_px: Some([150, 10, corner[0], corner[1]]),
        environment,
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let mut draw = |environment: CameraEnvironment, sky| {
        let mirror = Node::camera(mirror(environment), vec![terrain(&behind)]);
        let scene = rig.scene(Node::group(vec![mirror, terrain(&main)]));
        let picture = rig.picture(&scene, &main, &Environment { sky, ..around(&main) });
        rig.release(scene);
        picture
    };
    let with = draw(CameraEnvironment::Inherited, Sky::Atmosphere);
    keep("air-mirror", &with);
    let part = image::imageops::crop_imm(&with, 150, 10, corner[0], corner[1]).to_image();
    // At the edge of two triangles, another part of a target may round differently.
    assert!(differ(&part, &expected, 2) <= 20, "{}", differ(&part, &expected, 2));
    let outside = |x: u32, y: u32| !(150..150 + corner[0]).contains(&x) || !(10..10 + corner[1]).contains(&y);
    let same = |a: &RgbaImage, b: &RgbaImage| {
        a.enumerate_pixels().filter(|(x, y, _)| outside(*x, *y)).all(|(x, y, p)| p == b.get_pixel(x, y))
    };
    assert!(same(&with, &without), "the rest of the image does not change");
    // A background fills only its part.
    let with = draw(CameraEnvironment::Inherited, Sky::Background([1, 2, 250]));
    assert_eq!(with.get_pixel(152, 12).0, [1, 2, 250, 255]);
    assert_ne!(with.get_pixel(128, 180).0, [1, 2, 250, 255]);
    // So does the clear colour of a camera without air.
    let with = draw(CameraEnvironment::Light, Sky::Atmosphere);
    keep("light-mirror", &with);
    assert!(same(&with, &without), "the rest of the image does not change");
    assert_eq!(with.get_pixel(152, 12).0, [0, 0, 0, 255]);
    no_errors(rig);
}

#[test]
fn nested_cameras_have_light_and_air_of_their_own_eye() {
    let Some(mut rig) = rig("nested_cameras_have_light_and_air_of_their_own_eye") else { return };
    let rig = &mut *rig;
    let camera = looking(SIZE, [0.3, 0.3], 900.0, [0.6, 0.7]);
    let expected = picture(rig, &camera, &around(&camera));
    let outer = CullCamera { viewport_px: SIZE, clip_from_eye: camera.clip_from_eye, ..elsewhere() };
    let main = around(&outer);
    let node = like(&camera, CameraEnvironment::default());
    let (bare, _) = drawn(rig, node.clone(), vec![terrain(&camera)], &main);
    let mut draw = |environment: CameraEnvironment, is_below_projection: bool| {
        let order = RenderOrder::Nested;
        let mut nested = CameraNode { environment, order, target: None, ..node.clone() };
        let mut children = vec![terrain(&camera)];
        if is_below_projection {
            // A projection has the light and air of its camera.
            let mut projection = Node::new(NodeKind::Projection(camera.clip_from_eye));
            projection.children = children;
            children = vec![projection];
            nested.projection = None;
        }
        let scene = rig.scene(Node::camera(nested, children));
        let picture = rig.picture(&scene, &outer, &main);
        rig.release(scene);
        picture
    };
    // Only pixels of ground are compared, because the sky is that of the main view.
    let apart = |found: &RgbaImage, by: u8| {
        let pixels = found.pixels().zip(expected.pixels()).zip(bare.pixels()).filter(|(_, b)| b.0 != [0, 0, 0, 255]);
        let far = |a: [u8; 4], b: [u8; 4]| (0..3).any(|i| a[i].abs_diff(b[i]) > by);
        let (mut all, mut apart) = (0, 0);
        for ((found, expected), _) in pixels {
            all += 1;
            apart += usize::from(far(found.0, expected.0));
        }
        assert!(all > 10_000, "{all}");
        apart
    };
    let found = draw(CameraEnvironment::Inherited, false);
    keep("air-nested", &found);
    assert_eq!(apart(&found, 1), 0);
    assert_eq!(apart(&draw(CameraEnvironment::Inherited, true), 1), 0);
    assert!(apart(&draw(CameraEnvironment::Light, false), 8) > 10_000);
    let own = Environment { sun_color: [0.3, 0.1, 0.5], ..around(&camera) };
    let found = draw(CameraEnvironment::Own(Arc::new(own)), false);
    let expected = picture(rig, &camera, &own);
    let is_ground = |x, y| bare.get_pixel(x, y).0 != [0, 0, 0, 255];
    let near = |a: &[u8], b: &[u8]| (0..3).all(|i| a[i].abs_diff(b[i]) <= 1);
    assert!(found.enumerate_pixels().all(|(x, y, p)| !is_ground(x, y) || near(&p.0, &expected.get_pixel(x, y).0)));
    no_errors(rig);
}

#[test]
fn cameras_move_and_change_their_air() {
    let Some(mut rig) = rig("cameras_move_and_change_their_air") else { return };
    let rig = &mut *rig;
    let [first, second] =
        [looking(SIZE, [0.3, 0.3], 900.0, [0.6, 0.7]), looking(SIZE, [0.7, 0.2], 30_000.0, [0.5, 0.6])];
    let sink = Arc::new(PictureSink::default());
    let mut node = like(&first, CameraEnvironment::Inherited);
    let target = node.target.as_deref().unwrap().clone();
    node.target = Some(Arc::new(CameraTarget { read_back: Some(sink.clone()), ..target }));
    let mut scene: Scene = rig.scene(Node::group(vec![
        Node::camera(node.clone(), vec![terrain(&second)]).named("camera"),
        Node::group(vec![]).named("group"),
    ]));
    let page = scene.roots()[0];
    let id = scene.nodes_named(page, "camera").next().unwrap();
    let group = scene.nodes_named(page, "group").next().unwrap();
    assert_eq!(scene.camera(id).unwrap().view, first.eye_from_world);
    assert!(scene.camera(group).is_none());
    rig.draw(&scene, &elsewhere(), &around(&elsewhere()));
    (node.view, node.projection) = (second.eye_from_world, Some(second.clip_from_eye));
    scene.set_camera(id, node.clone()).unwrap();
    assert_eq!(scene.set_camera(group, node.clone()), Err(SceneError::NotACamera { node: group }));
    let nowhere = CameraNode { view: glam::DAffine3::from_scale(DVec3::splat(f64::NAN)), ..node };
    assert_eq!(scene.set_camera(id, nowhere), Err(SceneError::NotFinite));
    let mut found = None;
    for frame in 2..200 {
        rig.draw(&scene, &CullCamera { frame, ..elsewhere() }, &around(&elsewhere()));
        found = sink.take().filter(|p| p.frame >= 2);
        if found.is_some() {
            break;
        }
    }
    let found = RgbaImage::from_raw(SIZE[0], SIZE[1], found.unwrap().texels).unwrap();
    let expected = picture(rig, &second, &around(&second));
    assert_eq!(differ(&found, &expected, 1), 0);
    rig.release(scene);
    no_errors(rig);
}

#[test]
fn eyes_beyond_the_limit_of_air_are_counted() {
    let Some(mut rig) = rig("eyes_beyond_the_limit_of_air_are_counted") else { return };
    let rig = &mut *rig;
    let cameras: Vec<_> = (0..10).map(|i| looking([32, 32], [0.3, 0.3], 500.0 * 1.7f64.powi(i), [0.6, 0.7])).collect();
    let nodes = cameras.iter().map(|c| Node::camera(like(c, CameraEnvironment::Inherited), vec![]));
    let scene = rig.scene(Node::group(nodes.collect()));
    let main = elsewhere();
    // There are eleven eyes with the main one.
    for _ in 0..3 {
        assert_eq!(rig.draw(&scene, &main, &around(&main)).airs_refused, 3);
    }
    rig.release(scene);
    let scene = rig.scene(Node::group(vec![]));
    assert_eq!(rig.draw(&scene, &main, &around(&main)).airs_refused, 0);
    rig.release(scene);
    no_errors(rig);
}
