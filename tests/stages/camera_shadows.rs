//! Shadows of the sun in cameras of the graph: if enabled, cast by the nodes below them, in separate cascades.
//! Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use image::RgbaImage;
use kit::cameras::no_errors;
use kit::frames::{differ, keep};
use kit::rig::{Rig, camera, rig};
use kit::shadows::{check, cuboid, ground, solid, sunny, tower};
use kit::terrain::Terrain;
use terrane::cull::{CullCamera, RenderStage};
use terrane::draw::DrawStats;
use terrane::scene::{
    CameraEnvironment, CameraNode, CameraShadows, CameraTarget, Environment, Mesh, Node, PictureSink, ReferenceFrame,
    RenderOrder, SunShadows,
};

const SIZE: [u32; 2] = [256, 192];

fn to_sun() -> DVec3 {
    DVec3::new(1.0, 0.5, 1.0)
}

fn things() -> Node {
    Node::geode(vec![ground(200.0), cuboid(tower().min, tower().max)])
}

fn near() -> CullCamera {
    camera(SIZE, DVec3::new(-40.0, -50.0, 45.0), DVec3::new(0.0, 0.0, 2.0), DVec3::Z)
}

/// Returns the main camera.
fn elsewhere() -> CullCamera {
    camera([64, 64], DVec3::new(150.0, 20.0, 300.0), DVec3::new(140.0, 100.0, 0.0), DVec3::Z)
}

fn like(camera: &CullCamera, environment: CameraEnvironment, shadows: CameraShadows) -> CameraNode {
    CameraNode { environment, shadows, ..kit::cameras::like(camera) }
}

/// Returns the image of a camera to a texture. The main camera draws nothing.
fn drawn(rig: &mut Rig, node: CameraNode, children: Vec<Node>, main: &Environment) -> (RgbaImage, DrawStats) {
    kit::cameras::drawn(rig, node, children, &elsewhere(), main)
}

fn picture(rig: &mut Rig, camera: &CullCamera, environment: &Environment) -> RgbaImage {
    kit::cameras::picture(rig, things(), camera, environment)
}

#[test]
fn camera_to_a_texture_has_the_shadows_of_a_main_camera_there() {
    let Some(mut rig) = rig("camera_to_a_texture_has_the_shadows_of_a_main_camera_there") else { return };
    let rig = &mut *rig;
    let main = sunny(to_sun());
    let expected = picture(rig, &near(), &main);
    let bare = picture(rig, &near(), &Environment { shadows: None, ..main });
    // With the light of the main image and black behind it by default, and with its whole environment.
    for environment in [CameraEnvironment::Light, CameraEnvironment::Inherited] {
        let is_plain = environment == CameraEnvironment::Light;
        let node = like(&near(), environment, CameraShadows::Environment);
        let (found, stats) = drawn(rig, node, vec![things()], &main);
        keep(&format!("shadows-texture-{is_plain}"), &found);
        // The ground fills the image except for its upper edge.
        let (dark, lit) = check(&found, &rig.stage.pre_render[0].shadows, &near(), [&[tower()], &[]], to_sun());
        assert!(dark > 100 && lit > 5_000, "{dark} {lit}");
        if !is_plain {
            assert_eq!(differ(&found, &expected, 1), 0);
        }
        // The main image has cascades as well, but they are empty: nodes below a camera cast shadows only in its image.
        assert_eq!(rig.stage.shadows.cascades.iter().map(|c| c.stage.leaf_count()).sum::<usize>(), 0);
        assert_eq!(stats.shadow_leaves, rig.stage.counters.shadow_leaves);
        assert!(stats.shadow_leaves >= 4 && stats.passes >= 6, "{stats:?}");
    }
    let node = like(&near(), CameraEnvironment::Inherited, CameraShadows::None);
    let (found, stats) = drawn(rig, node, vec![things()], &main);
    assert_eq!((differ(&found, &bare, 1), stats.shadow_leaves), (0, 0));
    no_errors(rig);
}

#[test]
fn cameras_have_separate_shadow_settings() {
    let Some(mut rig) = rig("cameras_have_separate_shadow_settings") else { return };
    let rig = &mut *rig;
    // The main image has none; the texture has some with another resolution, and from another sun.
    let main = Environment { shadows: None, ..sunny(to_sun()) };
    let small = SunShadows { resolution_px: 512, cascades: 2, ..SunShadows::default() };
    let expected = picture(rig, &near(), &Environment { shadows: Some(small), ..main });
    let node = like(&near(), CameraEnvironment::Inherited, CameraShadows::Own(small));
    let (found, stats) = drawn(rig, node, vec![things()], &main);
    assert_eq!(rig.stage.pre_render[0].shadows.cascades.len(), 2);
    assert_eq!((differ(&found, &expected, 2), stats.passes), (0, 4));
    let other = sunny(DVec3::new(-1.0, 0.2, 0.5));
    let expected = picture(rig, &near(), &other);
    let node = like(&near(), CameraEnvironment::Own(Arc::new(other)), CameraShadows::Environment);
    let (found, _) = drawn(rig, node, vec![things()], &main);
    keep("shadows-own", &found);
    assert_eq!(differ(&found, &expected, 2), 0);
    // Invalid settings are reported.
    let wrong = SunShadows { cascades: 9, ..small };
    let node = like(&near(), CameraEnvironment::Inherited, CameraShadows::Own(wrong));
    let (_, stats) = drawn(rig, node, vec![things()], &main);
    assert_eq!(stats.shadow_leaves, 0);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("1 to 4 cascades, not 9")), "{errors:?}");
}

/// The mountains of a globe have a low sun with air and shadows, and the main eye is far above another position.
#[test]
fn terrain_in_a_texture_has_air_and_shadows() {
    let Some(mut rig) = rig("terrain_in_a_texture_has_air_and_shadows") else { return };
    let rig = &mut *rig;
    let terrain =
        Terrain { west: 0.2, south: 0.75, width: 0.01, relief_m: 2500.0, root_error_m: 200.0, textured: true };
    let up = terrain.up(0.5, 0.5);
    let east = DVec3::Z.cross(up).normalize();
    let shadows = Some(SunShadows { resolution_px: 1024, ..SunShadows::default() });
    let world = Environment { sun_direction: (0.15 * up + east).normalize(), shadows, ..Environment::default() };
    let eye = terrain.world(0.3, 0.3, 1_500.0);
    let seen = camera(SIZE, eye, terrain.world(0.6, 0.6, 0.0), up);
    let scene = rig.scene(terrain.tiles_for(&seen, eye, 4));
    let expected = rig.picture(&scene, &seen, &world.seen_from(eye));
    let bare = rig.picture(&scene, &seen, &Environment { shadows: None, ..world.seen_from(eye) });
    rig.release(scene);
    keep("shadows-terrain-picture", &expected);
    let shaded = differ(&expected, &bare, 8);
    assert!(shaded > 1_000, "there are shadows: {shaded}");
    let above = terrain.world(0.9, 0.1, 50_000.0);
    let sink = Arc::new(PictureSink::default());
    let mut node = like(&seen, CameraEnvironment::Inherited, CameraShadows::Environment);
    let target = node.target.as_deref().unwrap().clone();
    node.target = Some(Arc::new(CameraTarget { read_back: Some(sink.clone()), ..target }));
    let scene = rig.scene(Node::camera(node, vec![terrain.tiles_for(&seen, eye, 4)]));
    let main = camera([64, 64], above, terrain.world(0.9, 0.2, 0.0), terrain.up(0.9, 0.1));
    let found = (1..200).find_map(|frame| {
        rig.draw(&scene, &CullCamera { frame, ..main }, &world.seen_from(above));
        sink.take()
    });
    let found = RgbaImage::from_raw(SIZE[0], SIZE[1], found.unwrap().texels).unwrap();
    keep("shadows-terrain", &found);
    assert_eq!(differ(&found, &expected, 1), 0);
    rig.release(scene);
    no_errors(rig);
}

/// A mirror below the ground: a mirrored view has the shadows of the world.
#[test]
fn reflections_have_the_shadows_of_the_reflected_scene() {
    let Some(mut rig) = rig("reflections_have_the_shadows_of_the_reflected_scene") else { return };
    let rig = &mut *rig;
    let main = sunny(to_sun());
    let expected = picture(rig, &near(), &main);
    // Left and right are swapped in the world and in the image, which gives the same image, mirrored.
    let flip = DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)));
    let mut node = like(&near(), CameraEnvironment::Inherited, CameraShadows::Environment);
    node.view = flip * node.view;
    let (found, _) = drawn(rig, node, vec![things()], &main);
    let found = image::imageops::flip_horizontal(&found);
    keep("shadows-mirrored", &found);
    let apart = differ(&found, &expected, 16);
    assert!(apart < 60, "{apart} pixels differ");
    no_errors(rig);
}

#[test]
fn number_of_cameras_with_shadows_is_limited() {
    let Some(mut rig) = rig("number_of_cameras_with_shadows_is_limited") else { return };
    let rig = &mut *rig;
    let asks = |order| CameraNode {
        frame: ReferenceFrame::Absolute,
        view: near().eye_from_world,
        projection: Some(near().clip_from_eye),
        shadows: CameraShadows::Environment,
        clear_color: None,
        ..CameraNode::new(order)
    };
    let orders = [RenderOrder::PostRender(0), RenderOrder::PostRender(1), RenderOrder::PreRender(0)];
    let cameras = orders.iter().map(|order| Node::camera(asks(*order), vec![things()]));
    let scene = rig.scene(Node::group(cameras.collect()));
    let mut main = near();
    let with = |stage: &RenderStage| {
        stage.pre_render.iter().chain(&stage.post_render).filter(|s| !s.shadows.cascades.is_empty()).count()
    };
    for (most, refused) in [(4, 0), (3, 0), (2, 1), (0, 3)] {
        main.settings.shadowed_cameras = most;
        rig.draw(&scene, &main, &sunny(to_sun()));
        assert_eq!(rig.stage.counters.shadows_refused, refused);
        assert_eq!(with(&rig.stage), 3 - refused as usize);
    }
    rig.release(scene);
    // Nested cameras count like others, and are served first.
    let nested = Node::camera(asks(RenderOrder::Nested), vec![things()]);
    let scene = rig.scene(Node::group(vec![Node::camera(asks(orders[0]), vec![things()]), nested]));
    main.settings.shadowed_cameras = 1;
    rig.draw(&scene, &main, &sunny(to_sun()));
    assert_eq!((rig.stage.counters.shadows_refused, with(&rig.stage)), (1, 0));
    assert_eq!(rig.stage.views[0].shadows.cascades.len(), 4);
    rig.release(scene);
    no_errors(rig);
}

#[test]
fn nested_cameras_have_shadows_beside_those_of_the_main_image() {
    let Some(mut rig) = rig("nested_cameras_have_shadows_beside_those_of_the_main_image") else { return };
    let rig = &mut *rig;
    let main = sunny(to_sun());
    let expected = picture(rig, &near(), &main);
    // A nested camera has another eye and lens, in an image whose main eye sees only the nested one.
    let node = |environment: CameraEnvironment, shadows: CameraShadows| CameraNode {
        frame: ReferenceFrame::Absolute,
        view: near().eye_from_world,
        projection: Some(near().clip_from_eye),
        environment,
        shadows,
        ..CameraNode::new(RenderOrder::Nested)
    };
    let outer = CullCamera { viewport_px: SIZE, ..elsewhere() };
    for environment in [CameraEnvironment::Inherited, CameraEnvironment::Light] {
        let node = node(environment, CameraShadows::Environment);
        let scene = rig.scene(Node::camera(node, vec![things()]));
        let found = rig.picture(&scene, &outer, &main);
        keep("shadows-nested", &found);
        assert_eq!(differ(&found, &expected, 1), 0);
        let (dark, lit) = check(&found, &rig.stage.views[0].shadows, &near(), [&[tower()], &[]], to_sun());
        assert!(dark > 100 && lit > 5_000, "{dark} {lit}");
        rig.release(scene);
    }
    // Both have the same eye. Each tower stands on separate ground and casts its shadow there.
    let patch = |x: f64| {
        let mesh = Mesh::rectangle(DVec3::new(x, -80.0, 0.0), DVec3::X * 79.0, DVec3::Y * 160.0);
        let tower_x = DVec3::X * (x + 60.0);
        Node::geode(vec![solid(mesh), cuboid(tower().min + tower_x, tower().max + tower_x)])
    };
    let eye = camera(SIZE, DVec3::new(0.0, -130.0, 110.0), DVec3::new(0.0, 0.0, 2.0), DVec3::Z);
    let scene = rig.scene(Node::group(vec![patch(0.0), patch(-80.0)]));
    let expected = rig.picture(&scene, &eye, &main);
    rig.release(scene);
    let same = |shadows| CameraNode { shadows, ..CameraNode::new(RenderOrder::Nested) };
    let mut apart = |shadows| {
        let nested = Node::camera(same(shadows), vec![patch(-80.0)]);
        let scene = rig.scene(Node::group(vec![patch(0.0), nested]));
        let stats = rig.draw(&scene, &eye, &main);
        let found = rig.read_back();
        rig.release(scene);
        keep("shadows-beside", &found);
        (differ(&found, &expected, 70), stats.passes)
    };
    // Edges belong to other texels.
    let (with, passes) = apart(CameraShadows::Environment);
    assert!(with < 10 && passes == 9, "{with} pixels, {passes} passes");
    let small = SunShadows { resolution_px: 512, cascades: 2, ..SunShadows::default() };
    let (with, passes) = apart(CameraShadows::Own(small));
    assert!(with < 60 && passes == 7, "{with} pixels, {passes} passes");
    let (without, passes) = apart(CameraShadows::None);
    assert!(without > 100 && passes == 5, "{without} pixels, {passes} passes");
    no_errors(rig);
}
