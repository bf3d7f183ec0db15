//! The viewer's event phase: handlers, masks, quit keys, callbacks of nodes, and the usual handlers. Images need a GPU;
//! a software adapter suffices.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use glam::{DAffine3, DVec2, DVec3};
use kit::viewer::{Settle, offscreen};

use terrane::gpu::{AdapterChoice, GraphicsContext};
use terrane::scene::{Drawable, Material, Mesh, Node, NodeId, Page, PageId, Sky, Traverse, UpdateCallback};
use terrane::state::{Mode, StateSet, StateValue};
use terrane::viewer::handlers::{self, StateSetManipulator, StatsPage};
use terrane::viewer::manipulators::{OrbitManipulator, usual};
use terrane::viewer::{
    AnimationPath, CompositeViewer, EventKind, EventMask, GuiActionAdapter, GuiEventAdapter, GuiEventHandler,
    KEY_COLOR, Key, Modifiers, MouseButton, ThreadingModel, Viewer, ViewerConfig, WindowCommand, coverage,
    event_callback,
};

fn viewer(adapter: AdapterChoice) -> Option<Viewer> {
    let validation = adapter != AdapterChoice::Noop;
    let config = ViewerConfig { size_px: [320, 240], adapter, validation, ..ViewerConfig::default() };
    offscreen(&config)
}

/// Returns a square of 2 m in the x, z plane around the origin that faces -y.
fn add_square(viewer: &mut Viewer) -> PageId {
    let mesh = Mesh::rectangle(DVec3::new(-1.0, 0.0, -1.0), 2.0 * DVec3::X, 2.0 * DVec3::Z);
    let material = Material { base_color: [0.1, 0.8, 0.2, 1.0], unlit: true, ..Material::default() };
    let square = Node::transform(DAffine3::IDENTITY, vec![Node::geode(vec![Drawable::new(mesh.into(), material)])]);
    let root = viewer.add_root(Page::from_node(square).unwrap()).unwrap();
    viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
    viewer.view_mut().environment.fog.enabled = false;
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -5.0, 0.0), DVec3::ZERO, DVec3::Z);
    root
}

fn press(viewer: &mut Viewer, key: Key) {
    let queue = viewer.view_mut().event_queue();
    let time_s = queue.time_s();
    queue.key_press(key, key, time_s);
    queue.key_release(key, key, time_s);
    viewer.frame().unwrap();
}

/// A handler that records the kinds of its events.
struct Notes {
    log: Rc<RefCell<Vec<String>>>,
    name: &'static str,
    mask: EventMask,
    ignores: EventMask,
    answers: bool,
}

impl GuiEventHandler for Notes {
    fn handle(&mut self, event: &GuiEventAdapter, _: &mut GuiActionAdapter<'_>) -> bool {
        if !matches!(event.kind, EventKind::Frame) {
            self.log.borrow_mut().push(format!("{} {:?}", self.name, event.mask()));
        }
        self.answers
    }

    fn event_mask(&self) -> EventMask {
        self.mask
    }

    fn ignore_handled_mask(&self) -> EventMask {
        self.ignores
    }
}

#[test]
fn handlers_are_called_in_order_by_their_masks() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    let log = Rc::new(RefCell::new(Vec::new()));
    let notes = |name, mask, ignores, answers| Notes { log: log.clone(), name, mask, ignores, answers };
    viewer.view_mut().add_event_handler(notes("moves", EventMask::MOVE, EventMask::ALL, false));
    viewer.view_mut().add_event_handler(notes("answers", EventMask::ALL, EventMask::ALL, true));
    viewer.view_mut().add_event_handler(notes("late", EventMask::ALL, EventMask::ALL, false));
    viewer.view_mut().add_event_handler(notes("curious", EventMask::ALL, EventMask::NONE, false));
    viewer.view_mut().add_event_handler(notes("half", EventMask::ALL, EventMask::MOVE, false));
    viewer.view_mut().event_queue().mouse_motion(DVec2::new(10.0, 10.0), 0.0);
    viewer.view_mut().event_queue().mouse_scroll(DVec2::new(0.0, 1.0), 0.0);
    viewer.frame().unwrap();
    let (moved, scrolled) = (EventMask::MOVE, EventMask::SCROLL);
    let expected: Vec<String> = [
        ("moves", moved),
        ("answers", moved),
        ("curious", moved),
        ("answers", scrolled),
        ("curious", scrolled),
        ("half", scrolled),
    ]
    .map(|(name, mask)| format!("{name} {mask:?}"))
    .into();
    assert_eq!(*log.borrow(), expected);
}

/// A handler that adds another handler once, and removes all on a key.
struct Changes(Rc<RefCell<Vec<String>>>, bool);

impl GuiEventHandler for Changes {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        if event.key_pressed() == Some(Key::Char('x')) {
            viewer.clear_event_handlers();
        } else if !std::mem::replace(&mut self.1, true) {
            let log = self.0.clone();
            let (mask, ignores) = (EventMask::ALL, EventMask::ALL);
            viewer.add_event_handler(Notes { log, name: "added", mask, ignores, answers: false });
        }
        false
    }
}

#[test]
fn handler_may_change_the_list_of_handlers() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    let log = Rc::new(RefCell::new(Vec::new()));
    viewer.view_mut().add_event_handler(Changes(log.clone(), false));
    viewer.view_mut().event_queue().mouse_motion(DVec2::ZERO, 0.0);
    viewer.view_mut().event_queue().mouse_motion(DVec2::ONE, 0.0);
    viewer.frame().unwrap();
    assert_eq!(log.borrow().len(), 1, "from the next event on");
    press(&mut viewer, Key::Char('x'));
    log.borrow_mut().clear();
    viewer.view_mut().event_queue().mouse_motion(DVec2::ZERO, 0.0);
    viewer.frame().unwrap();
    assert!(log.borrow().is_empty());
}

#[test]
fn quit_keys_closing_and_requests_end_the_loop() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    press(&mut viewer, Key::Char('q'));
    assert!(!viewer.view().is_done());
    press(&mut viewer, Key::Escape);
    assert!(viewer.view().is_done());
    viewer.view_mut().set_done(false);
    viewer.view_mut().set_quit_keys(&[Key::Char('q')]);
    press(&mut viewer, Key::Escape);
    assert!(!viewer.view().is_done());
    viewer.view_mut().event_queue().set_modifiers(Modifiers { control: true, ..Modifiers::default() });
    press(&mut viewer, Key::Char('q'));
    assert!(!viewer.view().is_done(), "Control+Q is another key");
    viewer.view_mut().event_queue().set_modifiers(Modifiers::default());
    press(&mut viewer, Key::Char('q'));
    assert!(viewer.view().is_done());
    viewer.view_mut().set_done(false);
    viewer.view_mut().event_queue().close_window(0.0);
    viewer.frame().unwrap();
    assert!(viewer.view().is_done());
    viewer.view_mut().set_done(false);
    viewer.view_mut().event_queue().quit_application(0.0);
    viewer.frame().unwrap();
    assert!(viewer.view().is_done());
    // A handler that consumes the close event keeps the window open ("save first?").
    viewer.view_mut().set_done(false);
    let log = Rc::default();
    let (mask, ignores) = (EventMask::CLOSE_WINDOW, EventMask::ALL);
    viewer.view_mut().add_event_handler(Notes { log, name: "", mask, ignores, answers: true });
    viewer.view_mut().event_queue().close_window(0.0);
    viewer.frame().unwrap();
    assert!(!viewer.view().is_done());
}

#[test]
fn nodes_receive_each_event_and_each_frame_once() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    let (frames, events) = (Arc::new(AtomicU32::new(0)), Arc::new(Mutex::new(Vec::new())));
    let mut node = Node::group(vec![Node::group(Vec::new()); 1000]);
    let (counter, log) = (frames.clone(), events.clone());
    node.update_callback = Some(UpdateCallback::new(move |_, _, info| {
        assert_eq!(info.frame, counter.fetch_add(1, Ordering::Relaxed) + 1);
        Traverse::Below
    }));
    node.event_callback = Some(event_callback(move |_, node, event| {
        log.lock().unwrap().push((node.index, event.mask()));
        Traverse::Below
    }));
    viewer.add_root(Page::from_node(node).unwrap()).unwrap();
    viewer.frame().unwrap();
    events.lock().unwrap().clear();
    viewer.view_mut().event_queue().mouse_scroll(DVec2::new(0.0, 1.0), 0.0);
    viewer.view_mut().event_queue().key_press(Key::Char('a'), Key::Char('a'), 0.0);
    viewer.frame().unwrap();
    let expected = [(0, EventMask::SCROLL), (0, EventMask::KEY_DOWN), (0, EventMask::FRAME)];
    assert_eq!(*events.lock().unwrap(), expected);
    assert_eq!(frames.load(Ordering::Relaxed), 2);
}

#[test]
fn camera_follows_a_node_that_update_has_moved() {
    use terrane::viewer::manipulators::{NodeTrackerManipulator, TrackerMode};
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    let root = add_square(&mut viewer);
    let node = NodeId { page: root, index: 0 };
    let moves = UpdateCallback::new(move |scene, node, info| {
        let place = DAffine3::from_translation(DVec3::X * 100.0 * f64::from(info.frame));
        scene.set_transform(node, place).unwrap();
        Traverse::Below
    });
    viewer.scene_mut().set_update_callback(node, Some(moves)).unwrap();
    viewer.set_manipulator(Some(Box::new(NodeTrackerManipulator::new(node, TrackerMode::NodeCenter))));
    for frame in 1..4 {
        viewer.frame().unwrap();
        let to = DVec3::X * 100.0 * f64::from(frame) - viewer.view().camera.eye();
        assert!(to.normalize().dot(viewer.view().camera.direction()) > 1.0 - 1e-9, "one frame late");
    }
}

#[test]
fn space_returns_home_and_the_pointer_is_a_ray() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    add_square(&mut viewer);
    viewer.set_manipulator(Some(Box::new(OrbitManipulator::default())));
    viewer.frame().unwrap();
    assert!(viewer.view().camera.eye().distance(DVec3::new(0.0, -5.0, 0.0)) < 1e-9, "it starts at the camera");
    press(&mut viewer, Key::SPACE);
    let home = viewer.manipulator_view().home_pose();
    assert!(viewer.view().camera.eye().distance(home.translation) < 1e-9);

    viewer.set_manipulator(None);
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -5.0, 0.0), DVec3::ZERO, DVec3::Z);
    let hit = Rc::new(RefCell::new(None));
    struct Points(Rc<RefCell<Option<DVec3>>>);
    impl GuiEventHandler for Points {
        fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
            let ray = viewer.ray_at(event).unwrap();
            *self.0.borrow_mut() = Some(ray.origin + ray.direction * (-ray.origin.y / ray.direction.y));
            false
        }
        fn event_mask(&self) -> EventMask {
            EventMask::PUSH
        }
    }
    viewer.view_mut().add_event_handler(Points(hit.clone()));
    let corner = viewer.view().window_matrix().window_from_world(DVec3::new(1.0, 0.0, 1.0)).unwrap();
    viewer.view_mut().event_queue().mouse_motion(corner.truncate(), 0.0);
    viewer.view_mut().event_queue().mouse_button_press(MouseButton::Left, 0.0);
    viewer.frame().unwrap();
    assert!(hit.borrow().unwrap().distance(DVec3::new(1.0, 0.0, 1.0)) < 1e-9);
}

#[test]
fn usual_handlers_react_to_their_keys_and_show_messages() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    add_square(&mut viewer);
    let folder = tempfile::tempdir().unwrap();
    viewer.set_manipulator(Some(Box::new(usual(None))));
    handlers::add_usual(viewer.view_mut(), folder.path(), StatsPage::None);
    viewer.composite_mut().set_threading_model(ThreadingModel::SingleThreaded).unwrap();
    // A key has one effect.
    let usage = viewer.view().usage();
    let mut keys: Vec<&str> = usage.iter().flat_map(|line| line.keys.split(", ")).filter(|k| k.len() == 1).collect();
    keys.sort_unstable();
    let all = keys.len();
    keys.dedup();
    assert!(all > 12 && keys.len() == all, "{keys:?}");

    let scale = viewer.view().camera.settings.lod_scale;
    press(&mut viewer, Key::Char('*'));
    assert!((viewer.view().camera.settings.lod_scale * 1.1 - scale).abs() < 1e-12);
    assert!(viewer.view().notice().unwrap().contains("0.91"));
    press(&mut viewer, Key::Char('m'));
    assert_eq!(viewer.composite().threading_model(), ThreadingModel::CullDrawThreadPerContext);
    assert_eq!(viewer.view().notice(), Some("CullDrawThreadPerContext"));
    for _ in 0..3 {
        press(&mut viewer, Key::Char('m'));
    }
    assert_eq!(viewer.composite().threading_model(), ThreadingModel::SingleThreaded);
    press(&mut viewer, Key::Char('f'));
    press(&mut viewer, Key::F(2));
    assert_eq!(
        viewer.view_mut().take_window_commands(),
        [WindowCommand::ToggleFullScreen, WindowCommand::Resize([1280, 720])]
    );
    assert!(viewer.view().state_set().is_none());
    for key in ['w', 'l', 'b', 't'] {
        press(&mut viewer, Key::Char(key));
        assert!(viewer.view().state_set().is_some());
    }
    for key in ['w', 'w', 'l', 'b', 't'] {
        press(&mut viewer, Key::Char(key));
    }
    assert!(viewer.view().state_set().is_none());
    viewer.frame().unwrap();
    for key in ['s', 's', 's', 's', 'g', 'g', 'h'] {
        press(&mut viewer, Key::Char(key));
        assert!(viewer.view().shows_overlay());
    }
    // While a button is held, keys belong to the manipulator.
    viewer.view_mut().event_queue().mouse_button_press(MouseButton::Right, 0.0);
    press(&mut viewer, Key::Char('w'));
    assert!(viewer.view().state_set().is_none());
}

/// Regression: the application's state set was lost with the first key.
#[test]
fn key_switches_overlay_and_restore_the_applications_state_set() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    add_square(&mut viewer);
    viewer.view_mut().add_event_handler(StateSetManipulator::default());
    let off = StateValue::OFF | StateValue::OVERRIDE;
    let own = |name: &str| {
        let set = StateSet { name: name.to_owned(), color: Some([1.0, 0.0, 0.0, 1.0]), ..StateSet::default() };
        Arc::new(set.with_mode(Mode::Blend, StateValue::ON).with_mode(Mode::Lighting, StateValue::ON))
    };
    let [first, second] = ["first", "second"].map(own);
    viewer.view_mut().set_state_set(Some(first.clone()));
    press(&mut viewer, Key::Char('l'));
    let expected = (*first).clone().with_mode(Mode::Lighting, off);
    assert_eq!(**viewer.view().state_set().unwrap(), expected);
    press(&mut viewer, Key::Char('b'));
    assert_eq!(**viewer.view().state_set().unwrap(), expected.with_mode(Mode::CullFace, off));
    // The application sets another state set while a switch is on. From the next key on, that one is the base.
    viewer.view_mut().set_state_set(Some(second.clone()));
    press(&mut viewer, Key::Char('l'));
    assert_eq!(**viewer.view().state_set().unwrap(), (*second).clone().with_mode(Mode::CullFace, off));
    press(&mut viewer, Key::Char('b'));
    assert!(viewer.view().state_set().is_some_and(|set| Arc::ptr_eq(set, &second)));
    for own in [Some(first), None] {
        viewer.view_mut().set_state_set(own.clone());
        for key in ['l', 'l', 'w', 'w', 'w'] {
            press(&mut viewer, Key::Char(key));
        }
        assert_eq!(viewer.view().state_set().map(Arc::as_ptr), own.as_ref().map(Arc::as_ptr));
    }
}

#[test]
fn path_is_recorded_written_and_played_back() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    add_square(&mut viewer);
    let folder = tempfile::tempdir().unwrap();
    viewer.view_mut().add_event_handler(handlers::RecordCameraPathHandler::new(folder.path().join("a.path")));
    viewer.set_manipulator(Some(Box::new(OrbitManipulator::default())));
    press(&mut viewer, Key::Char('Z'));
    assert!(
        viewer.view().notice().unwrap().contains("a.path"),
        "nothing is recorded yet: {:?}",
        viewer.view().notice()
    );
    press(&mut viewer, Key::Char('z'));
    let places: Vec<DAffine3> = (0..5)
        .map(|i| {
            let pose = DAffine3::from_translation(DVec3::new(f64::from(i), -5.0, 0.0));
            viewer.actions().set_pose(&pose);
            std::thread::sleep(std::time::Duration::from_millis(5));
            viewer.frame().unwrap();
            viewer.view().camera.world_from_eye
        })
        .collect();
    press(&mut viewer, Key::Char('z'));
    let path = AnimationPath::read(&folder.path().join("a.path")).unwrap();
    // Each frame sees the camera of the previous frame.
    assert!(path.points().len() >= 5);
    assert!(places.iter().all(|p| path.points().iter().any(|c| c.position.distance(p.translation) < 1e-9)));

    press(&mut viewer, Key::Char('Z'));
    let during = viewer.view().camera.eye();
    assert!(during.distance(path.points()[0].position) < 2.0, "{during}");
    // A pause is not part of the path.
    let longer = std::time::Duration::from_secs_f64(path.duration_s() + 0.05);
    press(&mut viewer, Key::Char('p'));
    std::thread::sleep(longer);
    viewer.frame().unwrap();
    viewer.frame().unwrap();
    assert!(viewer.view().notice().is_none_or(|notice| !notice.contains("end of the path")));
    press(&mut viewer, Key::Char('p'));
    std::thread::sleep(longer);
    viewer.frame().unwrap();
    viewer.frame().unwrap();
    assert!(viewer.view().notice().unwrap().contains("end of the path"));
    // The orbit manipulator continues from the pose of the path.
    viewer.view_mut().event_queue().mouse_scroll(DVec2::new(0.0, -3.0), 0.0);
    viewer.frame().unwrap();
    std::thread::sleep(std::time::Duration::from_millis(300));
    viewer.frame().unwrap();
    assert!(viewer.view().camera.eye().distance(path.world_from_eye(path.last_s()).translation) > 1.0);
}

#[test]
fn on_demand_drawing_stops_when_nothing_changes() {
    let Some(mut viewer) = viewer(AdapterChoice::Noop) else { return };
    add_square(&mut viewer);
    viewer.set_manipulator(Some(Box::new(OrbitManipulator::default())));
    assert!(viewer.check_need_to_do_frame());
    for _ in 0..20 {
        viewer.frame().unwrap();
    }
    assert!(!viewer.check_need_to_do_frame());
    viewer.view_mut().event_queue().mouse_scroll(DVec2::new(0.0, 2.0), 0.0);
    assert!(viewer.check_need_to_do_frame());
    viewer.frame().unwrap();
    assert!(viewer.check_need_to_do_frame(), "the zoom is animated");
    while viewer.check_need_to_do_frame() {
        std::thread::sleep(std::time::Duration::from_millis(20));
        viewer.frame().unwrap();
    }
    let sender = viewer.view().user_events();
    std::thread::spawn(move || sender.send(Arc::new(()))).join().unwrap().unwrap();
    assert!(viewer.check_need_to_do_frame());
    viewer.frame().unwrap();
    viewer.view_mut().request_redraw();
    assert!(viewer.check_need_to_do_frame());
}

#[test]
fn toggles_change_the_image_and_overlays_cover_it() {
    let Some(mut viewer) = viewer(kit::adapter()) else { return };
    add_square(&mut viewer);
    let folder = tempfile::tempdir().unwrap();
    handlers::add_usual(viewer.view_mut(), folder.path(), StatsPage::None);
    let settle = |viewer: &mut Viewer| {
        viewer.settle(4);
        viewer.read_back().unwrap()
    };
    let filled = settle(&mut viewer);
    let full = coverage(&filled, KEY_COLOR);
    assert!(full > 0.05);
    press(&mut viewer, Key::Char('w'));
    // The message disappears after a while. Until then it covers the lower edge.
    let (notice_from, height) = (160, 240);
    let upper = |picture: &image::RgbaImage| image::imageops::crop_imm(picture, 0, 0, 320, notice_from).to_image();
    let lines = settle(&mut viewer);
    let upper_lines = coverage(&upper(&lines), KEY_COLOR);
    assert!(upper_lines > 0.001 && upper_lines < 0.3 * coverage(&upper(&filled), KEY_COLOR), "{upper_lines}");
    let lower = image::imageops::crop_imm(&lines, 0, notice_from, 320, height - notice_from).to_image();
    assert!(coverage(&lower, KEY_COLOR) > 0.02, "the message is visible");
    press(&mut viewer, Key::Char('w'));
    press(&mut viewer, Key::Char('w'));
    assert!(upper(&settle(&mut viewer)) == upper(&filled), "as before");

    for (key, least) in [('s', 0.02), ('h', 0.2)] {
        press(&mut viewer, Key::Char(key));
        let over = settle(&mut viewer);
        let more = coverage(&upper(&over), KEY_COLOR) - coverage(&upper(&filled), KEY_COLOR);
        assert!(more > least, "{key}: {more}");
        if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
            over.save(std::path::Path::new(&folder).join(format!("overlay-{key}.png"))).unwrap();
        }
    }
    press(&mut viewer, Key::Char('h'));

    press(&mut viewer, Key::Char('c'));
    viewer.finish().unwrap();
    assert!(viewer.take_pictures().is_empty(), "the application asked for none");
    viewer.frame().unwrap();
    drop(viewer);
    let written = image::open(folder.path().join("terrane-001.png")).unwrap();
    assert_eq!((written.width(), written.height()), (320, 240));
}

#[test]
fn each_view_of_a_composite_viewer_has_separate_input() {
    let config = ViewerConfig {
        size_px: [320, 240],
        adapter: AdapterChoice::Noop,
        validation: false,
        ..ViewerConfig::default()
    };
    let mut composite = CompositeViewer::new(&config).unwrap();
    let context = composite.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    let scene = composite.add_scene().unwrap();
    let counted = Arc::new(AtomicU32::new(0));
    let counter = counted.clone();
    let mut node =
        Node::geode(vec![Drawable::new(Mesh::rectangle(DVec3::ZERO, DVec3::X, DVec3::Z).into(), Material::default())]);
    node.update_callback = Some(UpdateCallback::new(move |_, _, _| {
        counter.fetch_add(1, Ordering::Relaxed);
        Traverse::Below
    }));
    composite.add_root(scene, Page::from_node(node).unwrap()).unwrap();
    let left = composite.add_view(scene, context, Some([0, 0, 160, 240])).unwrap();
    let right = composite.add_view(scene, context, Some([160, 0, 160, 240])).unwrap();
    for view in [left, right] {
        composite.actions(view).unwrap().set_manipulator(Some(Box::new(OrbitManipulator::default())));
    }
    composite.frame().unwrap();
    let eye = |composite: &CompositeViewer, id| composite.views().find(|(v, _)| *v == id).unwrap().1.camera.eye();
    let (left_eye, right_eye) = (eye(&composite, left), eye(&composite, right));

    // The wheel turns while the pointer is over the right view.
    assert_eq!(composite.view_at(context, DVec2::new(10.0, 10.0)).unwrap().0, left);
    let (view, at) = composite.view_at(context, DVec2::new(200.0, 10.0)).unwrap();
    assert_eq!((view, at), (right, DVec2::new(40.0, 10.0)));
    assert!(composite.view_at(context, DVec2::new(400.0, 10.0)).is_none());
    let queue = composite.view_mut(view).unwrap().event_queue();
    queue.mouse_motion(at, 0.0);
    queue.mouse_scroll(DVec2::new(0.0, 4.0), 0.0);
    for _ in 0..5 {
        std::thread::sleep(std::time::Duration::from_millis(20));
        composite.frame().unwrap();
    }
    assert_eq!(eye(&composite, left), left_eye);
    assert!(eye(&composite, right).distance(right_eye) > 0.1);
    assert_eq!(counted.load(Ordering::Relaxed), 6, "once per frame, with any number of views");

    let queue = composite.view_mut(left).unwrap().event_queue();
    queue.key_press(Key::Escape, Key::Escape, 0.0);
    assert!(!composite.is_done());
    composite.frame().unwrap();
    assert!(composite.is_done());
}
