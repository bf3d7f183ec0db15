//! Drawing on demand: events that request a frame, when drawing pauses, and how it resumes. Images need a GPU; a
//! software adapter suffices.

use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec2, DVec3};
use image::RgbaImage;
use kit::shapes::ball;
use kit::skip::or_skip;
use kit::viewer::{Settle, offscreen};
use terrane::cull::{Stereo, StereoMode};

#[cfg(feature = "http")]
use terrane::fetch::HttpConfig;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
#[cfg(feature = "http")]
use terrane::pager::ImageSequence;
use terrane::pager::PagerConfig;
use terrane::scene::{
    CameraNode, CameraTarget, CullAction, CullCallback, Node, NodeKind, OcclusionQueryNode, Page, PictureSink, Scene,
    Sky,
};
use terrane::state::{TextureFormat, TextureObject};
use terrane::viewer::manipulators::{
    AnimationPathManipulator, CameraManipulator, FirstPersonManipulator, FlyManipulator, OrbitManipulator,
};
use terrane::viewer::{
    AnimationPath, CompositeViewer, ControlPoint, Eyes, KEY_COLOR, Key, Slave, ThreadingModel, Viewer, ViewerConfig,
};

fn config(adapter: AdapterChoice) -> ViewerConfig {
    let validation = adapter != AdapterChoice::Noop;
    ViewerConfig { size_px: [160, 120], adapter, validation, max_contexts: 2, ..ViewerConfig::default() }
}

/// Draws until no frame is requested.
fn rest(viewer: &mut Viewer) {
    let start = Instant::now();
    while viewer.check_need_to_do_frame() {
        viewer.frame().unwrap();
        assert!(start.elapsed() < kit::MAX_WAIT, "it never pauses");
    }
}

/// Returns a viewer on a ball with a manipulator, which has rested for longer than any animation.
fn rested(manipulator: impl CameraManipulator + 'static) -> Viewer {
    let mut viewer = offscreen(&config(AdapterChoice::Noop)).unwrap();
    viewer.add_root(Page::from_node(ball(DVec3::ZERO, 1.0, [1.0; 4])).unwrap()).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z);
    viewer.set_manipulator(Some(Box::new(manipulator)));
    rest(&mut viewer);
    std::thread::sleep(Duration::from_millis(600));
    viewer
}

/// Sends an event and draws a frame. Returns the way of the eye, and the elapsed seconds.
fn moved(viewer: &mut Viewer, act: impl FnOnce(&mut Viewer)) -> (f64, f64) {
    let (start, from) = (Instant::now(), viewer.view().camera.eye());
    act(viewer);
    viewer.frame().unwrap();
    (viewer.view().camera.eye().distance(from), start.elapsed().as_secs_f64())
}

fn press(viewer: &mut Viewer, key: Key) {
    let queue = viewer.view_mut().event_queue();
    let time_s = queue.time_s();
    queue.key_press(key, key, time_s);
    queue.key_release(key, key, time_s);
}

/// Regression: the whole pause counted as time in which the camera moved.
#[test]
fn motion_starts_at_the_event() {
    let mut viewer = rested(OrbitManipulator::default());
    let (way_m, seconds) = moved(&mut viewer, |viewer| {
        let time_s = viewer.view_mut().event_queue().time_s();
        viewer.view_mut().event_queue().mouse_scroll(DVec2::new(0.0, 1.0), time_s);
    });
    // From 10 m to 8 m by factors, 63 % in each tenth of a second.
    let eased_m = |seconds: f64| 10.0 - 8.0 * 1.25f64.powf((-10.0 * seconds).exp());
    assert!(way_m > 0.0 && way_m <= eased_m(seconds) + 1e-9, "{way_m} m in {seconds} s");
    assert!(viewer.check_need_to_do_frame(), "the animation continues");
    // From then on all time counts.
    std::thread::sleep(Duration::from_millis(600));
    let (way_m, _) = moved(&mut viewer, |_| {});
    assert!(way_m > 0.9 * eased_m(0.5) - eased_m(seconds), "{way_m} m");

    let mut viewer = rested(FlyManipulator::default());
    let (way_m, seconds) = moved(&mut viewer, |viewer| press(viewer, Key::Up));
    // Outside of the ball, half of the distance in a second.
    assert!(way_m > 0.0 && way_m <= 5.0 * seconds, "{way_m} m in {seconds} s");
}

#[test]
fn path_resumes_where_it_was_paused() {
    let points = [0.0, 1e3].map(|time_s| {
        let pose = DAffine3::from_translation(DVec3::new(time_s, -10.0, 0.0));
        ControlPoint::from_pose(time_s, &pose)
    });
    let path = AnimationPath::new(points.into()).unwrap();
    let mut viewer = rested(OrbitManipulator::default());
    // The same for a path that gets the camera between two frames.
    let (_, seconds) = moved(&mut viewer, |viewer| {
        viewer.set_manipulator(Some(Box::new(AnimationPathManipulator::new(path))));
    });
    assert!(viewer.view().camera.eye().x <= 0.01 + seconds.min(0.1), "{} m", viewer.view().camera.eye().x);
    press(&mut viewer, Key::Char('p'));
    viewer.frame().unwrap();
    rest(&mut viewer);
    std::thread::sleep(Duration::from_millis(600));
    let (way_m, seconds) = moved(&mut viewer, |viewer| press(viewer, Key::Char('p')));
    assert!(way_m <= seconds + 1e-9, "{way_m} m in {seconds} s");
    let (way_m, _) = moved(&mut viewer, |_| std::thread::sleep(Duration::from_millis(100)));
    assert!(way_m >= 0.1, "{way_m} m");
}

/// Without a wake-up time the pause would never end.
#[test]
fn resting_camera_rises_with_the_ground() {
    let ground_mm = Arc::new(AtomicU64::new(0));
    let of_view = ground_mm.clone();
    let mut viewer = offscreen(&config(AdapterChoice::Noop)).unwrap();
    viewer.add_root(Page::from_node(ball(DVec3::ZERO, 1.0, [1.0; 4])).unwrap()).unwrap();
    viewer.view_mut().set_ground(Some(Box::new(move |_: &Scene, point: DVec3, _: DVec3| {
        Some(point.with_z(1e-3 * of_view.load(Ordering::Relaxed) as f64))
    })));
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -5.0, 1.7), DVec3::new(0.0, 0.0, 1.7), DVec3::Z);
    viewer.set_manipulator(Some(Box::new(FirstPersonManipulator::default())));
    rest(&mut viewer);
    assert!((viewer.view().camera.eye().z - 1.7).abs() < 1e-3);
    ground_mm.store(3000, Ordering::Relaxed);
    viewer.view_mut().request_redraw();
    rest(&mut viewer);
    assert!((viewer.view().camera.eye().z - 4.7).abs() < 1e-3, "{}", viewer.view().camera.eye());
}

/// Regression: they were awaited, and frames were drawn for them forever.
#[test]
fn images_of_a_closed_context_are_not_awaited() {
    let mut viewer = offscreen(&config(AdapterChoice::Noop)).unwrap();
    let first = viewer.context();
    let second = GraphicsContext::new_offscreen(&config(AdapterChoice::Noop).traits()).unwrap();
    let second = viewer.open_context(second).unwrap();
    viewer.add_slave(Slave::new(second)).unwrap();
    viewer.settle(2);
    viewer.composite_mut().want_picture(second);
    assert!(viewer.check_need_to_do_frame());
    assert!(viewer.composite_mut().close_context(second).unwrap());
    viewer.settle(4);
    viewer.finish().unwrap();
    assert!(!viewer.check_need_to_do_frame() && viewer.composite_mut().take_pictures(second).is_empty());
    // Its pending work is dropped.
    let held = Rc::new(());
    let of_capture = held.clone();
    viewer.actions().capture(Box::new(move |_, _| drop(of_capture)));
    assert_eq!(Rc::strong_count(&held), 2);
    assert!(viewer.composite_mut().close_context(first).unwrap());
    assert_eq!(Rc::strong_count(&held), 1);
    viewer.settle(4);
    assert!(!viewer.check_need_to_do_frame());
}

/// Regression: only the context of a viewer's main view requested one.
#[test]
fn resized_context_requests_a_frame() {
    let traits = |size_px| ContextTraits { size_px, ..config(AdapterChoice::Noop).traits() };
    let context = || GraphicsContext::new_offscreen(&traits([160, 90])).unwrap();
    let mut viewer = offscreen(&config(AdapterChoice::Noop)).unwrap();
    let second = viewer.open_context(context()).unwrap();
    viewer.add_slave(Slave::new(second)).unwrap();
    for context in viewer.contexts().collect::<Vec<_>>() {
        rest(&mut viewer);
        viewer.resize_context(context, [90, 160]).unwrap();
        assert!(viewer.check_need_to_do_frame(), "{context:?}");
    }
    let mut views = CompositeViewer::new(&config(AdapterChoice::Noop)).unwrap();
    let (first, second) = (views.open_context(context()).unwrap(), views.open_context(context()).unwrap());
    let scene = views.add_scene().unwrap();
    let view = views.add_view(scene, first, None).unwrap();
    for slaves in 0..2 {
        for context in [first, second] {
            (0..8).for_each(|_| views.frame().unwrap());
            assert!(!views.check_need_to_do_frame());
            views.resize_context(context, [90 + slaves, 160]).unwrap();
            assert_eq!(views.check_need_to_do_frame(), context == first || slaves > 0, "{context:?}");
        }
        views.add_slave(view, Slave::new(second)).unwrap();
    }
}

/// Regression: the last image arrived only when another frame was requested.
#[test]
fn frames_are_drawn_until_images_of_cameras_are_read_back() {
    let mut viewer = offscreen(&config(AdapterChoice::Noop)).unwrap();
    let sink = Arc::new(PictureSink::default());
    let texture = TextureObject::target("seen", [16, 16], TextureFormat::Rgba8Srgb);
    let camera = CameraNode::to_texture(
        texture.clone(),
        DAffine3::IDENTITY,
        viewer.view().camera.cull_camera([16, 16], 0, 0).clip_from_eye,
    );
    let target = CameraTarget { read_back: Some(sink.clone()), ..CameraTarget::clone(camera.target.as_ref().unwrap()) };
    let camera = CameraNode { target: Some(Arc::new(target)), ..camera };
    let node =
        Node { children: vec![ball(DVec3::ZERO, 1.0, [1.0; 4])], ..Node::new(NodeKind::Camera(Box::new(camera))) };
    viewer.add_root(Page::from_node(node).unwrap()).unwrap();
    for _ in 0..3 {
        let changed = viewer.frame_stamp().frame + 1;
        viewer.view_mut().request_redraw();
        rest(&mut viewer);
        let came = sink.take().map(|picture| picture.frame);
        assert!(came >= Some(changed), "{came:?} of a change in {changed}");
    }
}

/// Regression: the change was visible only when another frame was requested.
#[test]
fn changed_settings_are_drawn() {
    let mut viewer = rested(OrbitManipulator::default());
    let changes: [fn(&mut Viewer); 6] = [
        |viewer| viewer.view_mut().set_viewport([0, 0, 80, 60]),
        |viewer| viewer.view_mut().set_stereo(Some(Stereo::new(StereoMode::Anaglyphic))),
        |viewer| viewer.view_mut().set_eyes(Eyes::Left),
        |viewer| viewer.view_mut().set_state_set(Some(Arc::default())),
        |viewer| {
            let context = viewer.context();
            let slave = viewer.add_slave(Slave::new(context)).unwrap();
            rest(viewer);
            viewer.view_mut().slave_mut(slave).unwrap().viewport = [0, 0, 9, 9].into();
            assert!(viewer.check_need_to_do_frame());
            rest(viewer);
            viewer.remove_slave(slave).unwrap();
        },
        |viewer| {
            let context = viewer.context();
            viewer.add_slave(Slave::new(context)).unwrap();
        },
    ];
    for (i, change) in changes.into_iter().enumerate() {
        change(&mut viewer);
        assert!(viewer.check_need_to_do_frame(), "change {i}");
        rest(&mut viewer);
    }
    let mut viewer = CompositeViewer::new(&config(AdapterChoice::Noop)).unwrap();
    let context = GraphicsContext::new_offscreen(&config(AdapterChoice::Noop).traits()).unwrap();
    let context = viewer.open_context(context).unwrap();
    let scene = viewer.add_scene().unwrap();
    let [_, second] = [(); 2].map(|()| viewer.add_view(scene, context, [0, 0, 80, 60]).unwrap());
    while viewer.check_need_to_do_frame() {
        viewer.frame().unwrap();
    }
    viewer.remove_view(second).unwrap();
    assert!(viewer.check_need_to_do_frame(), "the covered area");
}

fn picture(viewer: &mut Viewer) -> RgbaImage {
    viewer.finish().unwrap();
    viewer.read_back().unwrap()
}

/// Regression: drawing paused before the queries had results, so that visible nodes stayed hidden.
#[test]
fn frames_are_drawn_until_occlusion_queries_have_shown_visible_nodes() {
    // Regression: a blocking frame culled first with the eye that issues queries.
    for (threading, blocking) in
        ThreadingModel::ALL.map(|t| (t, false)).into_iter().chain([(ThreadingModel::ALL[0], true)])
    {
        let pager = PagerConfig { blocking, ..PagerConfig::default() };
        let config = ViewerConfig { threading, pager, ..config(kit::adapter()) };
        let Some(mut viewer) = or_skip(Viewer::new_offscreen(&config)) else { return };
        let query = OcclusionQueryNode::default();
        let results = query.results.clone();
        let mut asked = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        asked.children = vec![ball(DVec3::new(0.0, 20.0, 0.0), 2.0, [0.0, 1.0, 0.0, 1.0])];
        let wall = ball(DVec3::ZERO, 4.0, [1.0, 0.0, 0.0, 1.0]);
        viewer.add_root(Page::from_node(Node::group(vec![wall, asked])).unwrap()).unwrap();
        viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
        viewer.view_mut().environment.fog.enabled = false;
        viewer.view_mut().camera.look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z);
        rest(&mut viewer);
        assert!(results.failures() >= 2, "{threading}: it pauses before the query has a result");
        let behind = picture(&mut viewer);
        for _ in 0..3 {
            let mut beside = viewer.view().camera;
            beside.look_at(DVec3::new(30.0, 0.0, 0.0), DVec3::new(0.0, 20.0, 0.0), DVec3::Z);
            for (pose, is_seen) in [(beside.world_from_eye, true), (viewer.view().camera.world_from_eye, false)] {
                viewer.actions().set_pose(&pose);
                viewer.view_mut().request_redraw();
                rest(&mut viewer);
                assert_eq!(results.samples() > 0, is_seen, "{threading}");
                let at_rest = picture(&mut viewer);
                (0..10).for_each(|_| viewer.frame().unwrap());
                assert!(at_rest == picture(&mut viewer), "{threading}: seen {is_seen}");
                assert_eq!(at_rest == behind, !is_seen, "{threading}");
            }
        }
    }
}

/// Returns twenty tiles side by side, with an eye that sees all.
fn write_row(folder: &Path) {
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let tile = |k: i32| {
        std::fs::write(folder.join(format!("{k}.glb")), &glb).unwrap();
        format!(
            r#"{{"boundingVolume":{{"sphere":[{},0,0,2]}},"geometricError":0,"content":{{"uri":"{k}.glb"}}}}"#,
            4 * k - 40
        )
    };
    let tiles: Vec<String> = (0..20).map(tile).collect();
    let root = format!(
        r#"{{"boundingVolume":{{"sphere":[0,0,0,60]}},"geometricError":1000,"refine":"ADD","children":[{}]}}"#,
        tiles.join(",")
    );
    let set = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":1000,"root":{root}}}"#);
    std::fs::write(folder.join("tileset.json"), set).unwrap();
}

fn row_viewer(source: &str, pager: PagerConfig) -> Viewer {
    let mut viewer = offscreen(&ViewerConfig { pager, ..config(AdapterChoice::Noop) }).unwrap();
    viewer.load(source).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -100.0, 0.0), DVec3::ZERO, DVec3::Z);
    viewer
}

fn tiles(viewer: &Viewer) -> (u64, u64) {
    let stats = viewer.pager().unwrap().stats();
    (stats.resident, stats.waiting + stats.in_flight)
}

/// Regression: frames were drawn forever for pages that waited for room.
#[test]
fn pages_without_room_request_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    write_row(folder.path());
    let pager = PagerConfig { max_tiles: 4, ..PagerConfig::default() };
    let mut viewer = row_viewer(folder.path().to_str().unwrap(), pager);
    rest(&mut viewer);
    assert_eq!(tiles(&viewer), (4, 16));
    assert!(!viewer.is_settled(), "some tiles are not loaded");
    // Tiles that become visible take the slots of those that leave the view.
    viewer.view_mut().camera.look_at(DVec3::new(-38.0, -5.0, 0.0), DVec3::new(-38.0, 0.0, 0.0), DVec3::Z);
    viewer.view_mut().request_redraw();
    rest(&mut viewer);
    assert!(viewer.is_settled(), "{:?}", viewer.pager().unwrap().stats());
    let drawn = viewer.stats().last().unwrap().tiles_drawn;
    assert!((2..=4).contains(&drawn), "{drawn}");
}

/// Regression: frames waited for requests that the pause prevented.
#[test]
fn paused_pager_requests_no_frame_until_it_resumes() {
    let folder = tempfile::tempdir().unwrap();
    write_row(folder.path());
    let stand: [fn(&mut Viewer, bool); 2] = [
        |viewer, stands| viewer.pager_mut().unwrap().set_paused(stands),
        |viewer, stands| viewer.pager_mut().unwrap().set_takes_requests(!stands),
    ];
    for (stand, waiting) in stand.into_iter().zip([20, 0]) {
        let mut viewer = row_viewer(folder.path().to_str().unwrap(), PagerConfig::default());
        stand(&mut viewer, true);
        rest(&mut viewer);
        assert_eq!(tiles(&viewer), (0, waiting));
        assert!(!viewer.is_settled());
        stand(&mut viewer, false);
        assert!(viewer.check_need_to_do_frame());
        rest(&mut viewer);
        assert_eq!(tiles(&viewer), (20, 0));
        assert!(viewer.is_settled());
    }
}

/// Regression: each frame culled as often as the deepest tree has levels.
#[test]
fn blocking_mode_retries_a_few_times_for_pages_without_room() {
    let folder = tempfile::tempdir().unwrap();
    write_row(folder.path());
    let pager = PagerConfig { max_tiles: 4, blocking: true, ..PagerConfig::default() };
    let mut viewer = row_viewer(folder.path().to_str().unwrap(), pager);
    let looks = Arc::new(AtomicU64::new(0));
    let mut counted = Node::group(Vec::new());
    let of_node = looks.clone();
    counted.cull_callback = Some(CullCallback(Arc::new(move |_| {
        of_node.fetch_add(1, Ordering::Relaxed);
        CullAction::Traverse
    })));
    viewer.add_root(Page::from_node(counted).unwrap()).unwrap();
    for frame in 0..10 {
        let before = looks.load(Ordering::Relaxed);
        viewer.frame().unwrap();
        let looks = looks.load(Ordering::Relaxed) - before;
        assert!((1..=10).contains(&looks), "{looks} in frame {frame}");
        assert_eq!(tiles(&viewer).0, 4);
    }
    rest(&mut viewer);
}

/// Regression: a loop that paused drew no frame for it.
#[cfg(feature = "http")]
#[test]
fn failed_tile_requests_a_frame_after_its_back_off() {
    use kit::server::{Reply, Server};
    let folder = tempfile::tempdir().unwrap();
    write_row(folder.path());
    image::RgbImage::from_pixel(8, 8, image::Rgb([200, 100, 50])).save(folder.path().join("picture.png")).unwrap();
    let files = folder.path().to_owned();
    let server = Server::start(move |request| match request.path() {
        path if path != "/tileset.json" && request.nth == 0 => Reply::new(503, ""),
        path => Reply::ok(std::fs::read(files.join(&path[1..])).unwrap()),
    });
    let retry_after = Duration::from_millis(300);
    let http = HttpConfig { max_retries: 0, ..HttpConfig::default() };
    let pager = PagerConfig { retry_after, http, ..PagerConfig::default() };
    let mut viewer = row_viewer(&server.url, pager);
    let sequence = ImageSequence::from_files("test", [format!("{}/picture.png", server.url)]);
    viewer.add_image_sequence(&sequence).unwrap();
    let _used = sequence.texture();
    let (start, mut has_rested) = (Instant::now(), false);
    while tiles(&viewer).0 < 20 || viewer.image_pager().unwrap().stats().loaded < 1 {
        assert!(start.elapsed() < kit::MAX_WAIT, "{:?}", viewer.pager().unwrap().stats());
        if viewer.check_need_to_do_frame() {
            viewer.frame().unwrap();
        } else {
            has_rested = true;
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    assert!(has_rested && start.elapsed() >= retry_after);
}
