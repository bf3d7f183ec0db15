//! Drawing on demand: what asks for a frame, what comes to rest, and how what rested moves again. Pictures need a GPU (a
//! software one will do).

#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod viewer_support;

use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec2, DVec3};
use image::RgbaImage;
use terrane::draw::Sky;
use terrane::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
use terrane::pager::PagerConfig;
use terrane::scene::{Node, NodeKind, OcclusionQueryNode, Page, Scene};
use terrane::viewer::manipulators::{
    AnimationPathManipulator, FirstPersonManipulator, FlyManipulator, OrbitManipulator,
};
use terrane::viewer::{
    AnimationPath, CameraManipulator, CompositeViewer, ControlPoint, KEY_COLOR, Key, Slave, ThreadingModel, Viewer,
    ViewerConfig,
};
use viewer_support::{Settle, ball, offscreen, or_skip};

fn config(adapter: AdapterChoice) -> ViewerConfig {
    let validation = adapter != AdapterChoice::Noop;
    ViewerConfig { size_px: [160, 120], adapter, validation, max_contexts: 2, ..ViewerConfig::default() }
}

/// Draws until nothing asks for a frame.
fn rest(viewer: &mut Viewer) {
    let start = Instant::now();
    while viewer.check_need_to_do_frame() {
        viewer.frame().unwrap();
        assert!(start.elapsed() < Duration::from_secs(60), "it never rests");
    }
}

/// A viewer on a ball, at rest with a manipulator, which has rested longer than what eases takes.
fn rested(manipulator: impl CameraManipulator + 'static) -> Viewer {
    let mut viewer = offscreen(&config(AdapterChoice::Noop)).unwrap();
    viewer.add_root(Page::from_node(ball(DVec3::ZERO, 1.0, [1.0; 4])).unwrap()).unwrap();
    viewer.camera.look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z);
    viewer.set_manipulator(Some(Box::new(manipulator)));
    rest(&mut viewer);
    std::thread::sleep(Duration::from_millis(600));
    viewer
}

/// What happens now and the frame after it; the eye's way, and the seconds that all took.
fn moved(viewer: &mut Viewer, act: impl FnOnce(&mut Viewer)) -> (f64, f64) {
    let (start, from) = (Instant::now(), viewer.camera.eye());
    act(viewer);
    viewer.frame().unwrap();
    (viewer.camera.eye().distance(from), start.elapsed().as_secs_f64())
}

fn press(viewer: &mut Viewer, key: Key) {
    let queue = viewer.event_queue();
    let time_s = queue.time_s();
    queue.key_press(key, key, time_s);
    queue.key_release(key, key, time_s);
}

/// All of the rest counted as time in which the camera had moved.
#[test]
fn what_rested_moves_from_the_event_on() {
    let mut viewer = rested(OrbitManipulator::default());
    let (way_m, seconds) = moved(&mut viewer, |viewer| {
        let time_s = viewer.event_queue().time_s();
        viewer.event_queue().mouse_scroll(DVec2::new(0.0, 1.0), time_s);
    });
    // From 10 m to 8 m, by factors, 63 % in each tenth of a second.
    let eased_m = |seconds: f64| 10.0 - 8.0 * 1.25f64.powf((-10.0 * seconds).exp());
    assert!(way_m > 0.0 && way_m <= eased_m(seconds) + 1e-9, "{way_m} m in {seconds} s");
    assert!(viewer.check_need_to_do_frame(), "it eases on");
    // From then on all time counts.
    std::thread::sleep(Duration::from_millis(600));
    let (way_m, _) = moved(&mut viewer, |_| {});
    assert!(way_m > 0.9 * eased_m(0.5) - eased_m(seconds), "{way_m} m");

    let mut viewer = rested(FlyManipulator::default());
    let (way_m, seconds) = moved(&mut viewer, |viewer| press(viewer, Key::Up));
    // Outside the ball by half the distance in a second.
    assert!(way_m > 0.0 && way_m <= 5.0 * seconds, "{way_m} m in {seconds} s");
}

#[test]
fn a_path_goes_on_where_it_was_paused() {
    let points = [0.0, 1e3].map(|time_s| {
        let pose = DAffine3::from_translation(DVec3::new(time_s, -10.0, 0.0));
        ControlPoint::from_pose(time_s, &pose)
    });
    let path = AnimationPath::new(points.into()).unwrap();
    let mut viewer = rested(OrbitManipulator::default());
    // One that is given the camera between two frames, too.
    let (_, seconds) = moved(&mut viewer, |viewer| {
        viewer.set_manipulator(Some(Box::new(AnimationPathManipulator::new(path))));
    });
    assert!(viewer.camera.eye().x <= 0.01 + seconds.min(0.1), "{} m", viewer.camera.eye().x);
    press(&mut viewer, Key::Char('p'));
    viewer.frame().unwrap();
    rest(&mut viewer);
    std::thread::sleep(Duration::from_millis(600));
    let (way_m, seconds) = moved(&mut viewer, |viewer| press(viewer, Key::Char('p')));
    assert!(way_m <= seconds + 1e-9, "{way_m} m in {seconds} s");
    let (way_m, _) = moved(&mut viewer, |_| std::thread::sleep(Duration::from_millis(100)));
    assert!(way_m >= 0.1, "{way_m} m");
}

/// With no time for what rests nobody would look.
#[test]
fn who_rests_on_the_ground_rises_with_it() {
    let ground_mm = Arc::new(AtomicU64::new(0));
    let of_view = ground_mm.clone();
    let mut viewer = offscreen(&config(AdapterChoice::Noop)).unwrap();
    viewer.add_root(Page::from_node(ball(DVec3::ZERO, 1.0, [1.0; 4])).unwrap()).unwrap();
    viewer.set_ground(Some(Box::new(move |_: &Scene, point: DVec3, _: DVec3| {
        Some(point.with_z(1e-3 * of_view.load(Ordering::Relaxed) as f64))
    })));
    viewer.camera.look_at(DVec3::new(0.0, -5.0, 1.7), DVec3::new(0.0, 0.0, 1.7), DVec3::Z);
    viewer.set_manipulator(Some(Box::new(FirstPersonManipulator::default())));
    rest(&mut viewer);
    assert!((viewer.camera.eye().z - 1.7).abs() < 1e-3);
    ground_mm.store(3000, Ordering::Relaxed);
    viewer.request_redraw();
    rest(&mut viewer);
    assert!((viewer.camera.eye().z - 4.7).abs() < 1e-3, "{}", viewer.camera.eye());
}

/// They were awaited, and frames drawn for them, for ever.
#[test]
fn pictures_of_a_closed_context_are_not_awaited() {
    let mut viewer = offscreen(&config(AdapterChoice::Noop)).unwrap();
    let first = viewer.context().unwrap();
    let second = GraphicsContext::new_offscreen(&config(AdapterChoice::Noop).traits()).unwrap();
    let second = viewer.open_context(second).unwrap();
    viewer.add_slave(Slave::new(second)).unwrap();
    viewer.settle(2);
    viewer.want_picture_of(second);
    assert!(viewer.check_need_to_do_frame());
    assert!(viewer.close_context(second).unwrap());
    viewer.settle(4);
    viewer.finish().unwrap();
    assert!(!viewer.check_need_to_do_frame() && viewer.take_pictures_of(second).is_empty());
    // What was to be done with one is forgotten.
    let held = Rc::new(());
    let of_capture = held.clone();
    viewer.capture(Box::new(move |_, _| drop(of_capture)));
    assert_eq!(Rc::strong_count(&held), 2);
    assert!(viewer.close_context(first).unwrap());
    assert_eq!(Rc::strong_count(&held), 1);
    viewer.settle(4);
    assert!(!viewer.check_need_to_do_frame());
}

/// Only the one context of a viewer's own view did.
#[test]
fn a_context_of_another_size_asks_for_a_frame() {
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

fn picture(viewer: &mut Viewer) -> RgbaImage {
    viewer.finish().unwrap();
    viewer.read_back().unwrap()
}

/// The last frames were those before the adapter had answered: what came into sight stayed hidden.
#[test]
fn frames_are_drawn_until_occlusion_queries_have_shown_what_is_in_sight() {
    // A blocking frame looks at what it would want first, and did so with the eye that asks.
    for (threading, blocking) in
        ThreadingModel::ALL.map(|t| (t, false)).into_iter().chain([(ThreadingModel::ALL[0], true)])
    {
        let pager = PagerConfig { blocking, ..PagerConfig::default() };
        let config = ViewerConfig { threading, pager, ..config(AdapterChoice::Software) };
        let Some(mut viewer) = or_skip(Viewer::new_offscreen(&config)) else { return };
        let query = OcclusionQueryNode::default();
        let results = query.results.clone();
        let mut asked = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        asked.children = vec![ball(DVec3::new(0.0, 20.0, 0.0), 2.0, [0.0, 1.0, 0.0, 1.0])];
        let wall = ball(DVec3::ZERO, 4.0, [1.0, 0.0, 0.0, 1.0]);
        viewer.add_root(Page::from_node(Node::group(vec![wall, asked])).unwrap()).unwrap();
        viewer.environment.sky = Sky::Background(KEY_COLOR);
        viewer.environment.fog.enabled = false;
        viewer.camera.look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z);
        rest(&mut viewer);
        assert!(results.failures() >= 2, "{threading}: it rests before what is behind is known to be");
        let behind = picture(&mut viewer);
        for _ in 0..3 {
            let mut beside = viewer.camera;
            beside.look_at(DVec3::new(30.0, 0.0, 0.0), DVec3::new(0.0, 20.0, 0.0), DVec3::Z);
            for (pose, is_seen) in [(beside.world_from_eye, true), (viewer.camera.world_from_eye, false)] {
                viewer.set_pose(&pose);
                viewer.request_redraw();
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
