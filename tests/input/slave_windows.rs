//! Events of windows in which slave cameras draw: their positions in the image of the master camera, their window and camera,
//! and their times. wgpu's noop adapter draws.

use std::sync::{Arc, Mutex};

use glam::{DAffine3, DMat4, DVec2, DVec3};
use terrane::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
use terrane::scene::{Node, Page};
use terrane::viewer::{
    ContextId, EventKind, EventSource, GuiActionAdapter, GuiEventAdapter, GuiEventHandler, MouseButton, MouseCursor,
    Slave, SlaveId, Viewer, ViewerConfig, WindowCommand,
};

const SIZE: [u32; 2] = [400, 200];

fn config() -> ViewerConfig {
    ViewerConfig { size_px: SIZE, adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() }
}

/// Creates a viewer, and a second context with a slave of another size.
fn viewer(slave: impl FnOnce(ContextId) -> Slave) -> (Viewer, ContextId, SlaveId) {
    let mut viewer = Viewer::new_offscreen(&config()).unwrap();
    viewer.add_root(Page::from_node(Node::group(vec![])).unwrap()).unwrap();
    // The position of the eye must not matter.
    viewer.view_mut().camera.look_at(DVec3::new(6e6, 1e6, 2e6), DVec3::ZERO, DVec3::Z);
    let traits = ContextTraits { size_px: [200, 100], ..config().traits() };
    let beside = viewer.open_context(GraphicsContext::new_offscreen(&traits).unwrap()).unwrap();
    let id = viewer.add_slave(slave(beside)).unwrap();
    viewer.realize().unwrap();
    (viewer, beside, id)
}

fn near(found: DVec2, expected: DVec2) {
    assert!(found.distance(expected) < 1e-6, "{found}, not {expected}");
}

#[test]
fn positions_in_a_slave_window_become_those_of_the_master_camera() {
    // The window shows the area on the right of the master's image, at half its size.
    let right = |context| Slave {
        projection_offset: DMat4::from_translation(DVec3::new(-2.0, 0.0, 0.0)),
        ..Slave::new(context)
    };
    let (mut viewer, beside, slave) = viewer(right);
    let (first, view) = (viewer.context(), viewer.view_mut());
    for (at, expected) in
        [([0.0, 0.0], [400.0, 0.0]), ([100.0, 50.0], [600.0, 100.0]), ([200.0, 100.0], [800.0, 200.0])]
    {
        near(view.focus_camera(beside, at.into()), expected.into());
        assert_eq!(view.event_queue().source(), EventSource { context: Some(beside), slave: Some(slave) });
    }
    near(view.focus_camera(first, DVec2::new(30.0, 40.0)), DVec2::new(30.0, 40.0));
    assert_eq!(view.event_queue().source(), EventSource { context: Some(first), slave: None });
    // A slave in a part of the window, which its offset does not move.
    view.slave_mut(slave).unwrap().projection_offset = DMat4::IDENTITY;
    view.slave_mut(slave).unwrap().viewport = [50, 20, 100, 50].into();
    near(view.focus_camera(beside, DVec2::new(100.0, 45.0)), DVec2::new(200.0, 100.0));
    near(view.focus_camera(beside, DVec2::new(75.0, 20.0)), DVec2::new(100.0, 0.0));
    // Without a camera under the pointer, the window's first one counts.
    near(view.focus_camera(beside, DVec2::new(0.0, 45.0)), DVec2::new(-200.0, 100.0));
}

#[test]
fn turned_slave_shows_directions_of_the_master_or_its_edge() {
    let turned = |degrees: f64| {
        move |context| Slave {
            // The slave looks to the right of the master.
            view_offset: DAffine3::from_rotation_y(degrees.to_radians()),
            ..Slave::new(context)
        }
    };
    let (mut aside, beside, _) = viewer(turned(20.0));
    let at = aside.view_mut().focus_camera(beside, DVec2::new(100.0, 50.0));
    // The half width of the master's image is the tangent of 30 degrees.
    near(at, DVec2::new(200.0 + 200.0 * 20f64.to_radians().tan() / 30f64.to_radians().tan(), 100.0));
    let (mut back, beside, _) = viewer(turned(150.0));
    let at = back.view_mut().focus_camera(beside, DVec2::new(100.0, 50.0));
    near(at, DVec2::new(400.0, 100.0));
}

/// Regression: once the window of the master camera was closed, positions were taken to be in the world instead of in its eye
/// space, and drags in the windows left over turned the view a little or not at all.
#[test]
fn positions_stay_when_the_window_of_the_master_camera_is_closed() {
    let right = |context| Slave {
        projection_offset: DMat4::from_translation(DVec3::new(-2.0, 0.0, 0.0)),
        ..Slave::new(context)
    };
    let (mut viewer, beside, _) = viewer(right);
    let first = viewer.context();
    assert!(viewer.composite_mut().close_context(first).unwrap());
    let view = viewer.view_mut();
    assert_eq!(view.context(), None);
    for (at, expected) in [([0.0, 0.0], [400.0, 0.0]), ([100.0, 75.0], [600.0, 150.0])] {
        near(view.focus_camera(beside, at.into()), expected.into());
    }
}

#[test]
fn pressed_button_keeps_the_camera() {
    let half = |context| Slave { viewport: [0, 0, 100, 100].into(), ..Slave::new(context) };
    let (mut viewer, beside, left) = viewer(half);
    let right = viewer.add_slave(Slave { viewport: [100, 0, 100, 100].into(), ..Slave::new(beside) }).unwrap();
    let view = viewer.view_mut();
    let of = |view: &mut terrane::viewer::View| view.event_queue().source().slave;
    near(view.focus_camera(beside, DVec2::new(50.0, 50.0)), DVec2::new(200.0, 100.0));
    view.event_queue().mouse_button_press(MouseButton::Left, 0.0);
    near(view.focus_camera(beside, DVec2::new(150.0, 50.0)), DVec2::new(600.0, 100.0));
    assert_eq!(of(view), Some(left));
    view.event_queue().mouse_button_release(MouseButton::Left, 0.0);
    near(view.focus_camera(beside, DVec2::new(150.0, 50.0)), DVec2::new(200.0, 100.0));
    assert_eq!(of(view), Some(right));
}

type Noted = Arc<Mutex<Vec<(String, f64, EventSource, f64)>>>;

/// Notes kind, time and source of events, and the reference time of the frame.
struct Note(Noted);

impl GuiEventHandler for Note {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        let kind = format!("{:?}", event.kind);
        let noted = (kind, event.time_s, event.source, viewer.frame_stamp().reference_time_s);
        self.0.lock().unwrap().push(noted);
        false
    }
}

#[test]
fn events_of_all_views_have_the_time_of_the_frame_stamp() {
    let (mut viewer, beside, slave) = viewer(Slave::new);
    viewer.frame().unwrap();
    std::thread::sleep(std::time::Duration::from_millis(30));
    // A view that is added later has the same clock.
    let (scene, first) = (viewer.scene_id(), viewer.context());
    let later = viewer.composite_mut().add_view(scene, first, Some([0, 0, 10, 10])).unwrap();
    let ids = [viewer.view_id(), later];
    let noted = Noted::default();
    for id in ids {
        let view = viewer.composite_mut().view_mut(id).unwrap();
        view.add_event_handler(Note(noted.clone()));
        let at = view.focus_camera(beside, DVec2::new(100.0, 50.0));
        let queue = view.event_queue();
        queue.mouse_motion(at, queue.time_s());
        queue.user_event(Arc::new(7), queue.time_s());
    }
    viewer.frame().unwrap();
    let noted = std::mem::take(&mut *noted.lock().unwrap());
    let moves: Vec<_> = noted.iter().filter(|(kind, ..)| kind == "Move").collect();
    assert_eq!(moves.len(), 2);
    let (before, after) = (moves[0].1, moves[1].1);
    assert!(before >= 0.03 && after >= before && after - before < 5.0, "{before} {after}");
    for (kind, time_s, source, frame_s) in &noted {
        match kind.as_str() {
            "Move" => assert!(time_s <= frame_s && frame_s - time_s < 5.0, "{time_s} in the frame at {frame_s}"),
            "Frame" => assert!(time_s >= frame_s && time_s - frame_s < 5.0, "{time_s} in the frame at {frame_s}"),
            _ => {}
        }
        if kind != "Move" && !kind.starts_with("Resize") {
            assert_eq!(*source, EventSource::default(), "{kind} belongs to no window");
        }
    }
    assert_eq!(moves[0].2, EventSource { context: Some(beside), slave: Some(slave) });
    assert_eq!(moves[1].2, EventSource { context: Some(beside), slave: None }, "the later view has no camera there");
}

#[test]
fn moved_pointer_is_known_at_once_and_asked_of_the_window() {
    let (mut viewer, ..) = viewer(Slave::new);
    let view = viewer.view_mut();
    view.set_viewport([100, 50, 200, 100]);
    view.set_cursor(MouseCursor::Crosshair);
    view.warp_pointer(DVec2::new(10.0, 20.0));
    view.warp_pointer(DVec2::NAN);
    assert_eq!(view.event_queue().state().position, DVec2::new(10.0, 20.0));
    let commands = view.take_window_commands();
    assert_eq!(
        commands,
        [WindowCommand::SetCursor(MouseCursor::Crosshair), WindowCommand::WarpPointer(DVec2::new(110.0, 70.0))]
    );
    let mut events = Vec::new();
    view.event_queue().take_frame(&mut events, 0.0);
    assert!(!events.iter().any(|event| matches!(event.kind, EventKind::Move | EventKind::Drag)));
}
