//! Manipulators over loaded ground: the terrain manipulator stays above it, and walking follows it. No GPU.

use glam::{DVec2, DVec3};
use kit::tile_sets::generate;
use terrane::gpu::AdapterChoice;
use terrane::math::WGS84;
use terrane::pager::PagerConfig;
use terrane::scene::{HeightQuery, Vertical};
use terrane::viewer::manipulators::{FirstPersonManipulator, GroundHeight as _, SceneGround, TerrainManipulator};
use terrane::viewer::{MouseButton, Viewer, ViewerConfig};

fn viewer(folder: &std::path::Path) -> Viewer {
    let set = generate(&folder.join("set"), |args| (args.levels, args.size) = (Some(3), 10_000.0));
    let pager = PagerConfig { build_kd_trees: true, blocking: true, ..PagerConfig::default() };
    let config = ViewerConfig {
        size_px: [320, 240],
        adapter: AdapterChoice::Noop,
        validation: false,
        pager,
        max_sse_px: 3.0,
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.load(&set).unwrap();
    viewer.view_mut().set_ground(Some(Box::new(SceneGround::default())));
    viewer.frame().unwrap();
    viewer
}

fn frames(viewer: &mut Viewer, count: u32) {
    for _ in 0..count {
        std::thread::sleep(std::time::Duration::from_millis(15));
        viewer.frame().unwrap();
    }
}

#[test]
fn ground_of_the_scene_equals_the_height_query() {
    let folder = tempfile::tempdir().unwrap();
    let viewer = viewer(folder.path());
    let bounds = *viewer.bounds().unwrap();
    let query = HeightQuery::new(Vertical::Ellipsoid(WGS84));
    query.publish(viewer.scene());
    let ground = SceneGround::default();
    let mut met = 0;
    for i in 0..400 {
        let (x, y) = (f64::from(i % 20) - 9.7, f64::from(i / 20) - 9.6);
        for z in [-3000.0, 0.0, 50_000.0, 1.0e7] {
            let point = bounds.frame.world_from_local.transform_point3(DVec3::new(600.0 * x, 600.0 * y, z));
            let up = viewer.manipulator_view().frame_at(point).up();
            let expected = query.highest_ground_at(point).map(|g| g.point);
            let found = ground.ground_at(viewer.scene(), point, up);
            assert_eq!(found.is_some(), expected.is_some(), "{x} {y} {z}");
            if let (Some(found), Some(expected)) = (found, expected) {
                met += 1;
                assert!(found.distance(expected) < 1e-3, "{x} {y} {z}: {}", found.distance(expected));
            }
        }
    }
    assert!(met > 400, "{met}");
}

#[test]
fn manipulators_stay_above_the_loaded_ground() {
    let folder = tempfile::tempdir().unwrap();
    let mut viewer = viewer(folder.path());
    let above_m =
        |viewer: &Viewer| viewer.manipulator_view().height_above_ground_m(viewer.view().camera.eye()).unwrap();
    viewer.set_manipulator(Some(Box::new(TerrainManipulator::default())));
    viewer.actions().home();
    frames(&mut viewer, 2);
    // The camera moves down to the ground, and along it.
    for _ in 0..60 {
        viewer.view_mut().event_queue().mouse_scroll(DVec2::new(0.0, 1.0), 0.0);
    }
    frames(&mut viewer, 40);
    assert!(above_m(&viewer) >= 2.0 - 1e-6 && above_m(&viewer) < 10.0, "{}", above_m(&viewer));
    for _ in 0..6 {
        viewer.view_mut().event_queue().mouse_scroll(DVec2::new(0.0, -3.0), 0.0);
        viewer.view_mut().event_queue().mouse_motion(DVec2::new(160.0, 20.0), 0.0);
        viewer.view_mut().event_queue().mouse_button_press(MouseButton::Middle, 0.0);
        viewer.view_mut().event_queue().mouse_motion(DVec2::new(150.0, 230.0), 0.1);
        viewer.view_mut().event_queue().mouse_button_release(MouseButton::Middle, 0.5);
        for _ in 0..10 {
            frames(&mut viewer, 1);
            assert!(above_m(&viewer) >= 2.0 - 1e-6, "{}", above_m(&viewer));
        }
    }

    viewer.set_manipulator(Some(Box::new(FirstPersonManipulator::default())));
    frames(&mut viewer, 80);
    assert!((above_m(&viewer) - 1.7).abs() < 0.01, "{}", above_m(&viewer));
}
