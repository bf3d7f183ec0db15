//! The event queue: accumulated state, orientations, double clicks, focus, touch, and events from other threads. No
//! GPU.

use std::sync::Arc;

use glam::DVec2;
use proptest::prelude::*;
use terrane::viewer::{
    EventKind, EventMask, EventQueue, GuiEventAdapter, Key, Modifiers, MouseButton, TouchPhase, YOrientation,
};

fn taken(queue: &mut EventQueue) -> Vec<GuiEventAdapter> {
    let mut events = Vec::new();
    queue.take_frame(&mut events, 1.0);
    events
}

fn kinds(queue: &mut EventQueue) -> Vec<String> {
    taken(queue).iter().map(|e| format!("{:?}", e.kind)).collect()
}

#[test]
fn key_event_contains_the_position_of_the_pointer() {
    let mut queue = EventQueue::default();
    queue.window_resize([200, 100], 0.0);
    queue.mouse_motion(DVec2::new(150.0, 25.0), 0.1);
    queue.mouse_button_press(MouseButton::Right, 0.2);
    queue.set_modifiers(Modifiers { shift: true, ..Modifiers::default() });
    queue.key_press(Key::Char('S'), Key::Char('s'), 0.3);
    let events = taken(&mut queue);
    let key = &events[3];
    assert_eq!((key.mask(), key.time_s), (EventMask::KEY_DOWN, 0.3));
    assert_eq!(key.state.position, DVec2::new(150.0, 25.0));
    assert!(key.state.buttons.contains(MouseButton::Right) && !key.state.buttons.contains(MouseButton::Left));
    assert_eq!(key.key_pressed(), None, "while a button is held, keys belong to the manipulator");
    let mut free = key.clone();
    free.state.buttons = terrane::viewer::ButtonMask::default();
    assert_eq!(free.key_pressed(), Some(Key::Char('S')));
    assert!(events[1].state.buttons.is_empty(), "an event has the state of its time");
    assert_eq!(events.last().unwrap().mask(), EventMask::FRAME);
    assert_eq!(taken(&mut queue).len(), 1, "events are taken once");
}

#[test]
fn both_orientations_give_the_same_position() {
    let mut queue = EventQueue::default();
    queue.window_resize([200, 100], 0.0);
    queue.mouse_motion(DVec2::new(150.0, 25.0), 0.0);
    assert_eq!(queue.state().normalized(), DVec2::new(0.5, 0.5));
    assert_eq!(queue.state().position_in(YOrientation::IncreasingUpwards), DVec2::new(150.0, 75.0));
    queue.set_y_orientation(YOrientation::IncreasingUpwards);
    assert_eq!(queue.state().position, DVec2::new(150.0, 75.0));
    assert_eq!(queue.state().normalized(), DVec2::new(0.5, 0.5));
    queue.mouse_motion(DVec2::new(0.0, 0.0), 0.0);
    assert_eq!(queue.state().normalized(), DVec2::new(-1.0, -1.0));
}

#[test]
fn given_range_clamps_the_pointer() {
    let mut queue = EventQueue::default();
    queue.set_input_range(DVec2::new(-1.0, -1.0), DVec2::new(1.0, 1.0));
    queue.mouse_motion(DVec2::new(5.0, -7.0), 0.0);
    assert_eq!(queue.state().position, DVec2::new(5.0, -7.0));
    queue.set_use_fixed_input_range(true);
    assert_eq!(queue.state().position, DVec2::new(1.0, -1.0));
    queue.mouse_motion(DVec2::new(0.5, 9.0), 0.0);
    assert_eq!(queue.state().position, DVec2::new(0.5, 1.0));
}

#[test]
fn motion_with_a_button_down_is_a_drag() {
    let mut queue = EventQueue::default();
    queue.mouse_motion(DVec2::new(1.0, 1.0), 0.0);
    queue.mouse_button_press(MouseButton::Left, 0.0);
    queue.mouse_motion(DVec2::new(9.0, 9.0), 0.0);
    queue.mouse_button_release(MouseButton::Left, 0.0);
    queue.mouse_button_release(MouseButton::Left, 0.0);
    assert_eq!(kinds(&mut queue), ["Move", "Push(Left)", "Drag", "Release(Left)", "Frame"]);
}

#[test]
fn double_click_is_quick_near_and_with_one_button() {
    let click = |queue: &mut EventQueue, button, time_s| {
        queue.mouse_button_press(button, time_s);
        queue.mouse_button_release(button, time_s);
    };
    let (left, right) = (MouseButton::Left, MouseButton::Right);
    for (second, place, at_s, doubled) in [
        (left, 0.0, 0.2, true),
        (right, 0.0, 0.2, false),
        (left, 50.0, 0.2, false),
        (left, 0.0, 0.9, false),
        (left, 0.0, -0.1, false),
    ] {
        let mut queue = EventQueue::default();
        click(&mut queue, left, 0.0);
        queue.mouse_motion(DVec2::new(place, 0.0), 0.1);
        click(&mut queue, second, at_s);
        let count = |queue: &mut EventQueue, mask| taken(queue).iter().filter(|e| e.mask() == mask).count();
        assert_eq!(count(&mut queue, EventMask::DOUBLE_CLICK), usize::from(doubled), "{second:?} {place} {at_s}");
        // A third click starts a new sequence.
        click(&mut queue, second, at_s + 0.1);
        assert_eq!(count(&mut queue, EventMask::DOUBLE_CLICK), usize::from(!doubled));
    }
}

#[test]
fn pressed_keys_are_released_when_focus_is_lost() {
    let mut queue = EventQueue::default();
    queue.key_press(Key::Char('w'), Key::Char('w'), 0.0);
    queue.key_press(Key::Char('w'), Key::Char('w'), 0.5);
    queue.mouse_button_press(MouseButton::Left, 0.6);
    assert!(queue.is_held(Key::Char('w')));
    let events = taken(&mut queue);
    assert!(matches!(events[1].kind, EventKind::KeyDown { repeat: true, .. }));
    assert_eq!(events[1].key_pressed(), None);
    queue.focus(false, 0.7);
    assert!(!queue.is_held(Key::Char('w')) && queue.state().buttons.is_empty());
    queue.key_release(Key::Char('w'), Key::Char('w'), 0.8);
    let expected = ["KeyUp { key: Char('w'), unmodified: Char('w') }", "Release(Left)", "Focus(false)", "Frame"];
    assert_eq!(kinds(&mut queue), expected);
}

/// Plays touches. Returns all events except those of fingers as text, and the queue.
fn touched(acts: &[(u64, TouchPhase, f64, f64)]) -> (Vec<String>, EventQueue) {
    let mut queue = EventQueue::default();
    queue.window_resize([1000, 1000], 0.0);
    let _ = taken(&mut queue);
    for (id, phase, x, time_s) in acts {
        queue.touch(*id, *phase, DVec2::new(*x, 0.0), *time_s);
    }
    let events = taken(&mut queue);
    let pointer = events.iter().filter(|e| !(EventMask::TOUCH | EventMask::FRAME).intersects(e.mask()));
    (pointer.map(|e| format!("{:?}@{}", e.kind, e.state.position.x)).collect(), queue)
}

#[test]
fn single_finger_is_the_pointer() {
    use TouchPhase::{Began, Cancelled, Ended, Moved};
    const NAN: f64 = f64::NAN;
    type Case = (&'static str, &'static [(u64, TouchPhase, f64, f64)], &'static [&'static str]);
    let cases: &[Case] = &[
        (
            "drags",
            &[(7, Began, 1.0, 0.0), (7, Moved, 5.0, 0.1), (7, Ended, 6.0, 0.2)],
            &["Push(Left)@1", "Drag@5", "Drag@6", "Release(Left)@6"],
        ),
        (
            "taps twice, a finger's width away",
            &[(7, Began, 1.0, 0.0), (7, Ended, 1.0, 0.1), (8, Began, 21.0, 0.2), (8, Ended, 21.0, 0.3)],
            &["Push(Left)@1", "Release(Left)@1", "DoubleClick(Left)@21", "Release(Left)@21"],
        ),
        (
            "a second finger ends the drag, and its moves are a gesture",
            &[(7, Began, 1.0, 0.0), (8, Began, 50.0, 0.1), (7, Moved, 9.0, 0.2), (8, Moved, 90.0, 0.2)],
            &["Push(Left)@1", "Release(Left)@1"],
        ),
        (
            "fingers that are lifted one after the other do not click",
            &[
                (7, Began, 1.0, 0.0),
                (8, Began, 50.0, 0.1),
                (7, Ended, 1.0, 0.2),
                (8, Moved, 55.0, 0.2),
                (8, Ended, 56.0, 0.3),
                (9, Began, 1.0, 0.35),
            ],
            &["Push(Left)@1", "Release(Left)@1", "Push(Left)@1"],
        ),
        (
            "the last finger drags from its position once it moves",
            &[
                (7, Began, 1.0, 0.0),
                (8, Began, 50.0, 0.1),
                (7, Ended, 1.0, 0.2),
                (8, Moved, 70.0, 0.2),
                (8, Moved, 80.0, 0.2),
                (8, Ended, 80.0, 0.3),
            ],
            &["Push(Left)@1", "Release(Left)@1", "Push(Left)@70", "Drag@80", "Release(Left)@80"],
        ),
        (
            "a cancelled finger is released at its last position",
            &[(7, Began, 1.0, 0.0), (7, Moved, 5.0, 0.1), (7, Cancelled, 300.0, 0.2), (8, Began, 5.0, 0.3)],
            &["Push(Left)@1", "Drag@5", "Release(Left)@5", "Push(Left)@5"],
        ),
        (
            "a finger without a position is still released",
            &[(7, Began, 1.0, 0.0), (7, Moved, NAN, 0.1), (7, Ended, NAN, 0.2)],
            &["Push(Left)@1", "Release(Left)@1"],
        ),
        (
            "unknown fingers are ignored",
            &[(7, Moved, 1.0, 0.0), (7, Ended, 1.0, 0.1), (8, Began, NAN, 0.2), (8, Moved, 2.0, 0.3)],
            &[],
        ),
        (
            "a finger that is pressed twice replaces the first",
            &[(7, Began, 1.0, 0.0), (7, Began, 9.0, 0.1), (7, Ended, 9.0, 0.2)],
            &["Push(Left)@1", "Release(Left)@1", "Push(Left)@9", "Release(Left)@9"],
        ),
    ];
    for (name, acts, expected) in cases {
        let (pointer, queue) = touched(acts);
        assert_eq!(pointer, *expected, "{name}");
        let is_down = queue.state().buttons.contains(MouseButton::Left);
        assert_eq!(is_down, pointer.last().is_some_and(|last| last.starts_with("Push")), "{name}");
    }
}

#[test]
fn number_of_fingers_is_limited() {
    let mut queue = EventQueue::default();
    queue.window_resize([1000, 1000], 0.0);
    (0..100u32).for_each(|id| queue.touch(id.into(), TouchPhase::Began, DVec2::splat(f64::from(id)), 0.0));
    assert_eq!(queue.finger_count(), 32);
    for step in 0..100_000u32 {
        queue.touch(u64::from(step % 32), TouchPhase::Moved, DVec2::splat(f64::from(step)), 1.0);
    }
    let events = taken(&mut queue);
    assert!(events.len() < 1200, "{} events wait", events.len());
    // The last event of each finger replaces its earlier ones.
    for id in 0..32u32 {
        let last = events.iter().rev().find_map(|e| match e.kind {
            EventKind::Touch { id: finger, position_px, .. } if finger == u64::from(id) => Some(position_px.x),
            _ => None,
        });
        assert_eq!(last, Some(f64::from(99_968 + id)));
    }
    queue.focus(false, 2.0);
    assert_eq!(queue.finger_count(), 0);
    let cancelled = taken(&mut queue);
    let cancelled =
        cancelled.iter().filter(|e| matches!(e.kind, EventKind::Touch { phase: TouchPhase::Cancelled, .. }));
    assert_eq!(cancelled.count(), 32);
}

#[test]
fn other_threads_can_send_events() {
    let mut queue = EventQueue::default();
    let sender = queue.user_events();
    std::thread::spawn(move || sender.send(Arc::new(42u32)).unwrap()).join().unwrap();
    let events = taken(&mut queue);
    assert_eq!((events[0].user::<u32>(), events[0].user::<String>()), (Some(&42), None));
    // A viewer that draws no frames must not fill memory.
    let sender = queue.user_events();
    assert_eq!((0..5000).filter(|n| sender.send(Arc::new(*n)).is_ok()).count(), 1024);
    for step in 0..100_000 {
        queue.mouse_motion(DVec2::splat(f64::from(step)), 0.0);
    }
    assert!(taken(&mut queue).len() < 2100);
}

proptest! {
    #[test]
    fn no_input_corrupts_the_state(
        raw in prop::collection::vec((0u8..8, prop::num::f64::ANY, prop::num::f64::ANY), 0..50),
        size in prop::array::uniform2(0u32..3),
    ) {
        let mut queue = EventQueue::default();
        queue.window_resize(size, 0.0);
        for (what, x, y) in raw {
            let place = DVec2::new(x, y);
            match what {
                0 => queue.mouse_motion(place, y),
                1 => queue.mouse_scroll(place, x),
                2 => queue.touch(u64::from(x > 0.0), TouchPhase::Moved, place, x),
                6 => queue.touch(u64::from(x > 0.0), TouchPhase::Began, place, x),
                7 => queue.touch(u64::from(x > 0.0), TouchPhase::Ended, place, x),
                3 => queue.set_input_range(place, DVec2::new(y, x)),
                4 => queue.mouse_button_press(MouseButton::Left, x),
                _ => queue.set_use_fixed_input_range(x > y),
            }
        }
        for event in taken(&mut queue) {
            prop_assert!(event.state.position.is_finite());
            prop_assert!(!event.state.normalized().is_nan());
        }
    }
}
