//! Cameras in the graph that show the scene: its roots and its paged content, from their pose. Images need a GPU; a
//! software adapter suffices.

use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec3, DVec4};
use image::RgbaImage;
use kit::cameras::like;
use kit::frames::{differ, keep};
use kit::shadows::small_maps;
use kit::shapes::ball;
use kit::tile_sets::small_set;
use kit::viewer::{Settle, offscreen};
use terrane::cull::CullCamera;
use terrane::pager::PagerConfig;
use terrane::scene::{
    CameraEnvironment, CameraNode, CameraShadows, CameraTarget, IntersectionLimit, Node, Page, PictureSink,
    ReferenceFrame, RenderOrder,
};
use terrane::viewer::{ThreadingModel, ViewFrom, Viewer, ViewerConfig};

const SIZE_PX: [u32; 2] = [240, 160];

fn viewer() -> Option<Viewer> {
    offscreen(&ViewerConfig {
        size_px: SIZE_PX,
        threading: ThreadingModel::SingleThreaded,
        adapter: kit::adapter(),
        max_sse_px: 2.0,
        pager: PagerConfig { blocking: true, build_kd_trees: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    })
}

fn pose(viewer: &Viewer, heading: f64, pitch: f64, range: f64) -> DAffine3 {
    let bounds = viewer.bounds().unwrap();
    bounds.first_camera(&ViewFrom { heading, pitch, range_m: Some(range * bounds.sphere.radius_m) })
}

/// Returns the viewer's camera at a pose.
fn camera_at(viewer: &Viewer, world_from_eye: DAffine3, size_px: [u32; 2]) -> CullCamera {
    let clip_from_eye = viewer.view().camera.clip_from_eye(size_px, 1.0);
    CullCamera {
        eye_from_world: world_from_eye.inverse(),
        clip_from_eye,
        viewport_px: size_px,
        ..CullCamera::default()
    }
}

/// Draws frames until everything is loaded, and a few more for fades.
fn settle(viewer: &mut Viewer) {
    viewer.settle(1);
    for frame in 0..3 {
        viewer.frame_at(1000.0 + f64::from(frame)).unwrap();
    }
    assert!(viewer.is_settled());
}

fn add(viewer: &mut Viewer, node: CameraNode, children: Vec<Node>) {
    viewer.add_root(Page::from_node(Node::camera(node, children)).unwrap()).unwrap();
}

#[test]
fn camera_to_a_texture_shows_the_scene_with_the_tiles_it_requests() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let Some(mut expects) = viewer() else { return };
    expects.load(&set).unwrap();
    expects.view_mut().environment.shadows = small_maps();
    let near = pose(&expects, 0.4, -0.3, 0.25);
    expects.view_mut().camera.world_from_eye = near;
    settle(&mut expects);
    let expected = expects.read_back().unwrap();
    keep("scene-camera-expected", &expected);

    // The main camera is far away, where the whole set needs one or two tiles.
    let mut viewer = viewer().unwrap();
    viewer.load(&set).unwrap();
    viewer.view_mut().environment.shadows = small_maps();
    viewer.view_mut().camera.world_from_eye = pose(&viewer, 2.0, -0.6, 30.0);
    settle(&mut viewer);
    let before = viewer.stats().last().unwrap().gpu_bytes;
    let alone = viewer.read_back().unwrap();
    let sink = Arc::new(PictureSink::default());
    let mut node = like(&camera_at(&expects, near, SIZE_PX));
    let target = node.target.as_deref().unwrap().clone();
    node.target = Some(Arc::new(CameraTarget { read_back: Some(sink.clone()), ..target }));
    node.environment = CameraEnvironment::Inherited;
    node.shadows = CameraShadows::Environment;
    node.shows_scene = true;
    // There are two mirrors. Neither shows the other, nor itself.
    add(&mut viewer, CameraNode { target: like(&camera_at(&expects, near, [32, 32])).target, ..node.clone() }, vec![]);
    add(&mut viewer, node, vec![]);
    settle(&mut viewer);
    assert!(viewer.stats().last().unwrap().gpu_bytes > before, "it requests tiles");
    sink.take();
    let found = (0..200).find_map(|_| {
        viewer.frame().unwrap();
        sink.take()
    });
    let found = RgbaImage::from_raw(SIZE_PX[0], SIZE_PX[1], found.unwrap().texels).unwrap();
    keep("scene-camera-found", &found);
    let apart = differ(&found, &expected, 2);
    assert!(apart < 40, "{apart} pixels differ");
    // The main image does not change.
    assert!(differ(&viewer.read_back().unwrap(), &alone, 2) < 40);
}

#[test]
fn part_of_the_window_shows_the_scene_and_can_be_picked() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let Some(mut viewer) = viewer() else { return };
    viewer.load(&set).unwrap();
    let (main, other) = (pose(&viewer, 0.4, -0.3, 0.4), pose(&viewer, 2.4, -0.7, 0.5));
    let inset = [130, 10, 100, 70];
    // The reference is an image from the pose of the inset with its size.
    viewer.view_mut().camera.world_from_eye = other;
    settle(&mut viewer);
    let expected = viewer.compute_intersections(120.0, 80.0, IntersectionLimit::Nearest)[0].world_point();
    viewer.view_mut().camera.world_from_eye = main;
    let as_seen = camera_at(&viewer, other, [inset[2], inset[3]]);
    let node = CameraNode {
        frame: ReferenceFrame::Absolute,
        view: as_seen.eye_from_world,
        projection: Some(as_seen.clip_from_eye),
        viewport_px: Some(inset),
        environment: CameraEnvironment::Inherited,
        shows_scene: true,
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    // Only the inset shows the mark.
    let mark = ball(expected, 150.0, [1.0, 0.0, 1.0, 1.0]);
    settle(&mut viewer);
    let alone = viewer.read_back().unwrap();
    add(&mut viewer, node.clone(), vec![mark]);
    settle(&mut viewer);
    let with = viewer.read_back().unwrap();
    keep("scene-inset", &with);
    let is_inset = |x: u32, y: u32| (130..230).contains(&x) && (10..80).contains(&y);
    let outside =
        |a: &RgbaImage| a.enumerate_pixels().filter(|(x, y, _)| !is_inset(*x, *y)).map(|(_, _, p)| *p).collect();
    let [a, b]: [Vec<image::Rgba<u8>>; 2] = [&with, &alone].map(outside);
    let changed = a.iter().zip(&b).filter(|(a, b)| a != b).count();
    assert_eq!(changed, 0, "the rest does not change");
    let inside = image::imageops::crop_imm(&with, inset[0], inset[1], inset[2], inset[3]).to_image();
    let colours = inside.pixels().map(|p| p.0.map(|c| c / 8)).collect::<std::collections::HashSet<_>>();
    assert!(colours.len() > 40, "{}", colours.len());
    let [r, g, b, _] = inside.get_pixel(50, 35).0;
    assert!(r > 180 && b > 180 && g < 90, "the mark");
    // The middle of the inset corresponds to the middle of an image from there.
    let hit = &viewer.compute_intersections(180.0, 45.0, IntersectionLimit::Nearest)[0];
    assert!((hit.world_point().distance(expected) - 150.0).abs() < 20.0, "the mark is hit first");
    let hits = viewer.compute_intersections(180.0, 45.0, IntersectionLimit::NoLimit);
    let ground = hits.iter().map(|hit| hit.world_point().distance(expected)).fold(f64::INFINITY, f64::min);
    assert!(ground < 20.0, "{ground}");
}

/// The inset is in front of the window's content: it has depths from 0.5 on, the main image less.
fn in_front(camera: &CullCamera) -> DMat4 {
    let nearer = DMat4::from_cols(DVec4::X, DVec4::Y, DVec4::new(0.0, 0.0, 0.5, 0.0), DVec4::new(0.0, 0.0, 0.5, 1.0));
    nearer * camera.clip_from_eye
}

#[test]
fn nested_camera_shows_the_scene_in_its_image() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let Some(mut viewer) = viewer() else { return };
    viewer.load(&set).unwrap();
    let inset = [130, 10, 100, 70];
    // Only ground is visible from there.
    let near = pose(&viewer, 0.4, -0.9, 0.25);
    let seen = camera_at(&viewer, near, [inset[2], inset[3]]);
    viewer.view_mut().camera.world_from_eye = pose(&viewer, 2.0, -0.6, 30.0);
    settle(&mut viewer);
    let (before, alone) = (viewer.stats().last().unwrap().gpu_bytes, viewer.read_back().unwrap());
    let node = CameraNode {
        frame: ReferenceFrame::Absolute,
        view: seen.eye_from_world,
        environment: CameraEnvironment::Inherited,
        shows_scene: true,
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let crop =
        |picture: &RgbaImage| image::imageops::crop_imm(picture, inset[0], inset[1], inset[2], inset[3]).to_image();
    // The reference is the image of a camera with a separate target at the pose.
    let after = CameraNode { projection: Some(seen.clip_from_eye), viewport_px: Some(inset), ..node.clone() };
    let mut drawn = |node: CameraNode| {
        let id = viewer.add_root(Page::from_node(Node::camera(node, vec![])).unwrap()).unwrap();
        settle(&mut viewer);
        let (bytes, picture) = (viewer.stats().last().unwrap().gpu_bytes, viewer.read_back().unwrap());
        let hits = viewer.compute_intersections(180.0, 45.0, IntersectionLimit::Nearest);
        let hit = hits.first().map_or(DVec3::INFINITY, |hit| hit.world_point());
        viewer.remove_root(id).unwrap();
        (picture, bytes, hit)
    };
    let (expected, _, expected_hit) = drawn(after.clone());
    keep("scene-nested-expected", &expected);
    let nested = CameraNode { order: RenderOrder::Nested, projection: Some(in_front(&seen)), ..after.clone() };
    let (found, bytes, hit) = drawn(nested.clone());
    keep("scene-nested-found", &found);
    assert!(bytes > before, "it requests tiles");
    assert_eq!(differ(&crop(&found), &crop(&expected), 2), 0);
    assert!(differ(&crop(&found), &crop(&alone), 8) > 5000);
    assert!(hit.distance(expected_hit) < 1.0, "{hit} {expected_hit}");
    // The rest of the image does not change: neither camera shows the other, nor itself.
    let other = CameraNode { viewport_px: Some([10, 80, 100, 70]), ..nested.clone() };
    let mut without = found.clone();
    image::imageops::replace(&mut without, &crop(&alone), inset[0].into(), inset[1].into());
    assert_eq!(differ(&without, &alone, 0), 0);
    let (second, ..) = drawn(other);
    assert_eq!(differ(&image::imageops::crop_imm(&second, 10, 80, 100, 70).to_image(), &crop(&found), 2), 0);
    // Without a viewport, a projection moves the image into the corner.
    let corner = DMat4::from_cols(
        DVec4::new(100.0 / 240.0, 0.0, 0.0, 0.0),
        DVec4::new(0.0, 70.0 / 160.0, 0.0, 0.0),
        DVec4::Z,
        DVec4::new(2.0 * 180.0 / 240.0 - 1.0, 1.0 - 2.0 * 45.0 / 160.0, 0.0, 1.0),
    );
    let projected = CameraNode { projection: Some(corner * in_front(&seen)), viewport_px: None, ..nested };
    let (found, _, hit) = drawn(projected);
    assert!(hit.distance(expected_hit) < 1.0, "{hit} {expected_hit}");
    keep("scene-nested-corner", &found);
    let apart = differ(&crop(&found), &crop(&expected), 24);
    assert!(apart < 350, "{apart} pixels differ");
}

#[test]
fn nested_camera_below_one_with_cleared_depth_gives_the_same_image() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let Some(mut viewer) = viewer() else { return };
    viewer.load(&set).unwrap();
    viewer.view_mut().environment.shadows = small_maps();
    let near = pose(&viewer, 0.4, -0.3, 0.25);
    let mut picture_of = |nested: bool| {
        let seen = camera_at(&viewer, near, SIZE_PX);
        let sink = Arc::new(PictureSink::default());
        let mut node = like(&seen);
        let target = node.target.as_deref().unwrap().clone();
        node.target = Some(Arc::new(CameraTarget { read_back: Some(sink.clone()), ..target }));
        node.environment = CameraEnvironment::Inherited;
        node.shadows = CameraShadows::Environment;
        node.shows_scene = !nested;
        let inner = CameraNode {
            environment: CameraEnvironment::Inherited,
            shadows: CameraShadows::Environment,
            shows_scene: true,
            ..CameraNode::new(RenderOrder::Nested)
        };
        let children = if nested { vec![Node::camera(inner, vec![])] } else { vec![] };
        let id = viewer.add_root(Page::from_node(Node::camera(node, children)).unwrap()).unwrap();
        viewer.view_mut().camera.world_from_eye = pose(&viewer, 2.0, -0.6, 30.0);
        settle(&mut viewer);
        sink.take();
        let found = (0..200).find_map(|_| {
            viewer.frame().unwrap();
            sink.take()
        });
        viewer.remove_root(id).unwrap();
        RgbaImage::from_raw(SIZE_PX[0], SIZE_PX[1], found.unwrap().texels).unwrap()
    };
    let (expected, found) = (picture_of(false), picture_of(true));
    keep("scene-below-expected", &expected);
    keep("scene-below-found", &found);
    assert_eq!(differ(&found, &expected, 2), 0);
}
