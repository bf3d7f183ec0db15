//! Scenes of the application: drawn, moved, resized, removed and added again, and tile sets that replace others. Needs
//! a GPU; a software adapter suffices.

use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use kit::tile_sets::{generate, small_set};
use kit::viewer::{Settle, offscreen};

use terrane::gpu::{AdapterChoice, GraphicsContext};
use terrane::math::Aabb;
use terrane::scene::{
    DistanceFog, Drawable, Environment, Geometry, Material, Mesh, MeshVertex, Node, NodeId, Page, Sky, SunShadows,
    Topology, Water,
};
use terrane::viewer::manipulators::OrbitManipulator;
use terrane::viewer::{CompositeViewer, KEY_COLOR, ThreadingModel, View, Viewer, ViewerConfig, coverage};

/// Returns a square of 2 m in the x, z plane that faces -y.
fn square() -> Drawable {
    let corner = |x: f32, z: f32| MeshVertex {
        position: [x, 0.0, z],
        normal: [0, -127, 0, 0],
        color: [255; 4],
        ..MeshVertex::default()
    };
    let mesh = Mesh {
        vertices: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        indices: Arc::from([0, 1, 2, 0, 2, 3]),
        topology: Topology::Triangles,
        bounds: Aabb { min: DVec3::new(-1.0, 0.0, -1.0), max: DVec3::new(1.0, 0.0, 1.0) },
        ..Mesh::default()
    };
    let material = Material { base_color: [1.0, 0.2, 0.1, 1.0], unlit: true, ..Material::default() };
    Drawable::new(Geometry::Mesh(Arc::new(mesh)), material)
}

fn viewer(threading: ThreadingModel, adapter: AdapterChoice) -> Option<Viewer> {
    let validation = adapter != AdapterChoice::Noop;
    let config = ViewerConfig { size_px: [160, 90], threading, adapter, validation, ..ViewerConfig::default() };
    offscreen(&config)
}

fn frames(viewer: &mut Viewer, count: u32) {
    for _ in 0..count {
        viewer.frame().unwrap();
    }
}

#[test]
fn square_is_drawn_moved_and_removed() {
    let mut pictures = Vec::new();
    for threading in ThreadingModel::ALL {
        let Some(mut viewer) = viewer(threading, kit::adapter()) else { return };
        let square = Node::transform(DAffine3::IDENTITY, vec![Node::geode(vec![square()])]);
        let root = viewer.add_root(Page::from_node(square).unwrap()).unwrap();
        viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
        viewer.view_mut().environment.fog.enabled = false;
        viewer.view_mut().camera.look_at(DVec3::new(0.0, -5.0, 0.0), DVec3::ZERO, DVec3::Z);
        frames(&mut viewer, 4);
        let picture = viewer.read_back().unwrap();
        // The square covers 2 m of the 5.77 m that 60 degrees show at 5 m, in both directions.
        let side = 2.0 / (2.0 * 5.0 * 30f64.to_radians().tan()) * 160.0;
        let expected = side * side / (160.0 * 90.0);
        assert!((coverage(&picture, KEY_COLOR) - expected).abs() < 0.01, "{}", coverage(&picture, KEY_COLOR));
        assert_eq!(picture.get_pixel(0, 0).0, [255, 0, 255, 255]);
        let [r, g, b, _] = picture.get_pixel(80, 45).0;
        assert!(r > 240 && g < 140 && b < 120, "{r} {g} {b}");

        viewer
            .scene_mut()
            .set_transform(NodeId { page: root, index: 0 }, DAffine3::from_scale(DVec3::splat(0.5)))
            .unwrap();
        frames(&mut viewer, 1);
        let smaller = viewer.read_back().unwrap();
        assert!((coverage(&smaller, KEY_COLOR) - expected / 4.0).abs() < 0.01);

        viewer.resize([90, 160]).unwrap();
        frames(&mut viewer, 1);
        let turned = viewer.read_back().unwrap();
        assert_eq!((turned.width(), turned.height()), (90, 160));

        assert!(viewer.remove_root(root).is_some());
        frames(&mut viewer, 2);
        assert_eq!(coverage(&viewer.read_back().unwrap(), KEY_COLOR), 0.0);
        pictures.push((picture, smaller, turned));
    }
    assert!(pictures[0] == pictures[1], "the threading model changes the image");
}

#[test]
fn near_plane_follows_the_nearest_geometry() {
    let Some(mut viewer) = viewer(ThreadingModel::SingleThreaded, kit::adapter()) else { return };
    viewer.add_root(Page::from_node(Node::geode(vec![square()])).unwrap()).unwrap();
    viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
    viewer.view_mut().environment.fog.enabled = false;
    // The eye jumps from far away to almost touching. The square must never be cut.
    for distance_m in [4000.0, 1.0, 500.0, 0.01, 0.001] {
        viewer.view_mut().camera.look_at(DVec3::new(0.0, -distance_m, 0.0), DVec3::ZERO, DVec3::Z);
        frames(&mut viewer, 1);
        let first = coverage(&viewer.read_back().unwrap(), KEY_COLOR);
        frames(&mut viewer, 1);
        let second = coverage(&viewer.read_back().unwrap(), KEY_COLOR);
        assert!(distance_m > 1.0 || second == 1.0, "{distance_m} m: {second}");
        assert!(distance_m == 4000.0 || first == second, "{distance_m} m: {first} and {second}");
    }
}

#[test]
fn frames_run_without_a_gpu_and_stats_are_kept() {
    let Some(mut viewer) = viewer(ThreadingModel::DrawThreadPerContext, AdapterChoice::Noop) else { return };
    viewer.add_root(Page::from_node(Node::geode(vec![square(), square()])).unwrap()).unwrap();
    let seen = Arc::new(std::sync::atomic::AtomicU32::new(0));
    let counter = Arc::clone(&seen);
    viewer.on_update(Box::new(move |_, stamp| counter.store(stamp.frame, std::sync::atomic::Ordering::Relaxed)));
    frames(&mut viewer, 20);
    let report = viewer.report().unwrap();
    assert_eq!((report.frames, report.draw.leaves, report.draw.triangles), (20, 2, 4));
    assert_eq!(seen.load(std::sync::atomic::Ordering::Relaxed), 20);
    assert!(viewer.stats().iter().all(|s| s.drawn && s.frame_ms >= s.cull_ms));
    assert!(viewer.is_settled() && viewer.converge_s().is_some());
}

/// Regression: it was added again without its drawables, and nothing was drawn or reported.
#[test]
fn removed_page_is_drawn_when_added_again() {
    for keep_drawables in [true, false] {
        let config =
            ViewerConfig { size_px: [160, 90], adapter: kit::adapter(), keep_drawables, ..ViewerConfig::default() };
        let Some(mut viewer) = offscreen(&config) else { return };
        let page = Page::from_node(Node::geode(vec![square(), square()])).unwrap();
        let size_bytes = page.size_bytes();
        let root = viewer.add_root(page).unwrap();
        viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
        viewer.view_mut().environment.fog.enabled = false;
        viewer.view_mut().camera.look_at(DVec3::new(0.0, -5.0, 0.0), DVec3::ZERO, DVec3::Z);
        viewer.settle(4);
        let before = coverage(&viewer.read_back().unwrap(), KEY_COLOR);
        let page = viewer.remove_root(root).unwrap();
        assert!(before > 0.05 && page.drawable_count() == 2);
        assert_eq!(page.size_bytes() == size_bytes, keep_drawables, "{} of {size_bytes} bytes", page.size_bytes());
        viewer.settle(2);
        assert_eq!(coverage(&viewer.read_back().unwrap(), KEY_COLOR), 0.0);
        viewer.add_root(page).unwrap();
        viewer.settle(4);
        let again = coverage(&viewer.read_back().unwrap(), KEY_COLOR);
        assert_eq!(again, if keep_drawables { before } else { 0.0 });
    }
}

fn small_and_large(folder: &Path) -> [String; 2] {
    let small = generate(&folder.join("small"), |args| (args.levels, args.size) = (Some(2), 500.0));
    [small, small_set(folder)]
}

/// The camera and all settings that depend on the size follow the new set. Regression: those of the old set stayed.
#[test]
fn set_that_replaces_another_is_seen_like_a_first_one() {
    let folder = tempfile::tempdir().unwrap();
    let [small, large] = small_and_large(folder.path());
    let made = || viewer(ThreadingModel::SingleThreaded, AdapterChoice::Noop);
    let (Some(mut fresh), Some(mut used)) = (made(), made()) else { return };
    fresh.load(&small).unwrap();
    let root = used.load(&large).unwrap();
    frames(&mut used, 1);
    assert!(used.remove_root(root).is_some());
    let root = used.load(&small).unwrap();
    let size = |viewer: &Viewer| viewer.bounds().unwrap().sphere;
    assert_eq!((size(&used).center, size(&used).radius_m), (size(&fresh).center, size(&fresh).radius_m));
    assert_eq!(used.view().camera.world_from_eye, fresh.view().camera.world_from_eye);
    assert!(used.is_height_set());
    // An application that changes its pages keeps its camera.
    assert!(used.root_uri().is_some_and(|uri| uri.starts_with(&small)));
    assert!(used.remove_root(root).is_some() && !used.is_height_set() && used.root_uri().is_none());
    used.add_root(Page::from_node(Node::geode(vec![square()])).unwrap()).unwrap();
    assert_eq!(used.view().camera.world_from_eye, fresh.view().camera.world_from_eye);
}

fn assert_same_pose(found: &DAffine3, expected: &DAffine3) {
    let apart_m = found.translation.distance(expected.translation);
    let turned = (found.matrix3 - expected.matrix3).abs().to_cols_array().into_iter().fold(0.0, f64::max);
    assert!(apart_m < 0.01 && turned < 1e-6, "{found:?} is not {expected:?}");
}

/// Regression: the manipulator moved the camera back in the same frame.
#[test]
fn manipulator_continues_from_the_first_view_of_a_set() {
    let folder = tempfile::tempdir().unwrap();
    let sets = small_and_large(folder.path());
    let made = || viewer(ThreadingModel::SingleThreaded, AdapterChoice::Noop);
    let Some(mut used) = made() else { return };
    let config = ViewerConfig { adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
    let mut composite = CompositeViewer::new(&config).unwrap();
    let context = composite.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    let [scene, other] = [(); 2].map(|()| composite.add_scene().unwrap());
    let [first, second, elsewhere] =
        [scene, scene, other].map(|scene| composite.add_view(scene, context, None).unwrap());
    used.set_manipulator(Some(Box::new(OrbitManipulator::default())));
    for view in [first, second, elsewhere] {
        composite.actions(view).unwrap().set_manipulator(Some(Box::new(OrbitManipulator::default())));
    }
    composite.frame().unwrap();
    let before = composite.view_mut(elsewhere).unwrap().camera.world_from_eye;
    for set in sets {
        let mut fresh = made().unwrap();
        fresh.load(&set).unwrap();
        let expected = fresh.view().camera.world_from_eye;
        let root = used.load(&set).unwrap();
        frames(&mut used, 1);
        assert_same_pose(&used.view().camera.world_from_eye, &expected);
        assert!(used.remove_root(root).is_some());
        let root = composite.load(scene, &set).unwrap();
        composite.frame().unwrap();
        for view in [first, second] {
            assert_same_pose(&composite.view_mut(view).unwrap().camera.world_from_eye, &expected);
        }
        assert_same_pose(&composite.view_mut(elsewhere).unwrap().camera.world_from_eye, &before);
        assert!(composite.remove_root(scene, root).unwrap().is_some());
    }
}

/// Camera, light and atmosphere follow the size of the set, not that of a page that was added first.
#[test]
fn set_is_seen_the_same_beside_pages_of_the_application() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let config = ViewerConfig { adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
    let mut composite = CompositeViewer::new(&config).unwrap();
    let context = composite.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    let scene = composite.add_scene().unwrap();
    let view = composite.add_view(scene, context, None).unwrap();
    let made = || viewer(ThreadingModel::SingleThreaded, AdapterChoice::Noop);
    let (Some(mut fresh), Some(mut used)) = (made(), made()) else { return };
    fresh.load(&set).unwrap();
    let page = || Page::from_node(Node::geode(vec![square()])).unwrap();
    used.add_root(page()).unwrap();
    composite.add_root(scene, page()).unwrap();
    assert_ne!(used.view().camera.world_from_eye, fresh.view().camera.world_from_eye);
    let root = used.load(&set).unwrap();
    composite.load(scene, &set).unwrap();
    assert_eq!(used.bounds(), fresh.bounds());
    assert_eq!(composite.bounds(scene).unwrap(), fresh.bounds());
    for seen in [used.view(), composite.view_mut(view).unwrap()] as [&View; 2] {
        assert_eq!(seen.camera.world_from_eye, fresh.view().camera.world_from_eye);
        assert_eq!(seen.environment, fresh.view().environment);
    }
    assert!(used.is_height_set() && composite.is_height_set(scene).unwrap());
    // A second set changes nothing.
    used.view_mut().camera.look_at(DVec3::new(0.0, -5.0, 0.0), DVec3::ZERO, DVec3::Z);
    let (camera, environment) = (used.view().camera, used.view().environment);
    used.add_root(page()).unwrap();
    assert_eq!((used.bounds(), used.view().camera.world_from_eye), (fresh.bounds(), camera.world_from_eye));
    assert_eq!(used.view().environment, environment);
    // A refused set changes nothing either, and another one instead of it is seen like a first one.
    assert!(used.load(&set).is_err());
    assert_eq!(used.view().camera.world_from_eye, camera.world_from_eye);
    assert!(used.remove_root(root).is_some());
    used.load(&set).unwrap();
    assert_eq!(used.view().camera.world_from_eye, fresh.view().camera.world_from_eye);
}

/// Regression: the first root reset light and air to their defaults.
#[test]
fn first_set_keeps_settings_that_do_not_depend_on_its_size() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let made = || viewer(ThreadingModel::SingleThreaded, AdapterChoice::Noop);
    let (Some(mut fresh), Some(mut own)) = (made(), made()) else { return };
    fresh.load(&set).unwrap();
    let asked = Environment {
        sun_color: [1.0, 0.5, 0.25],
        ambient_color: [0.1; 3],
        fog: DistanceFog { enabled: false, density_per_m: 1.0 },
        sky: Sky::Background(KEY_COLOR),
        water: Some(Water::at(3.0)),
        shadows: Some(SunShadows::default()),
        exposure: None,
        ..Environment::default()
    };
    own.view_mut().environment = asked;
    own.load(&set).unwrap();
    let Environment { sun_direction, up_in_world, fog: DistanceFog { density_per_m, .. }, .. } =
        fresh.view().environment;
    let fog = DistanceFog { density_per_m, ..asked.fog };
    assert_eq!(own.view().environment, Environment { sun_direction, up_in_world, fog, ..asked });
    assert!(density_per_m < 1e-3 && sun_direction != asked.sun_direction);
}
