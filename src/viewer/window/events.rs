//! Translates winit's events into those of the event queue. Main thread.

use std::path::PathBuf;

use glam::DVec2;
use winit::event::{ElementState, KeyEvent, MouseScrollDelta, Touch, WindowEvent};
use winit::keyboard::{Key as WinitKey, KeyCode, ModifiersState, NamedKey, PhysicalKey};

use crate::viewer::events::{EventQueue, Key, Modifiers, MouseButton, TouchPhase};
use crate::viewer::ids::ContextId;
use crate::viewer::view::View;

/// Pixels of scrolling on a touch pad that count as one notch of the wheel.
const PX_PER_NOTCH: f64 = 50.0;

/// Puts an event of a context's window into the queue of a view that has cameras in it. Returns false for events that the
/// queue has no counterpart for. Changes of size go through `Viewer::resize` instead.
pub fn feed(view: &mut View, context: ContextId, event: &WindowEvent) -> bool {
    let position_px = match event {
        WindowEvent::CursorMoved { position, .. } => DVec2::new(position.x, position.y),
        WindowEvent::Touch(Touch { location, .. }) => DVec2::new(location.x, location.y),
        WindowEvent::ModifiersChanged(_) => return feed_queue(view.event_queue(), event, DVec2::ZERO),
        WindowEvent::CloseRequested
        | WindowEvent::Focused(_)
        | WindowEvent::KeyboardInput { .. }
        | WindowEvent::MouseInput { .. }
        | WindowEvent::MouseWheel { .. }
        | WindowEvent::DroppedFile(_) => {
            view.focus_window(context);
            return feed_queue(view.event_queue(), event, DVec2::ZERO);
        }
        _ => return false,
    };
    let position_px = view.focus_camera(context, position_px);
    feed_queue(view.event_queue(), event, position_px)
}

/// Puts an event into a queue; `position_px` is its position in the view, if it has one.
fn feed_queue(queue: &mut EventQueue, event: &WindowEvent, position_px: DVec2) -> bool {
    let time_s = queue.time_s();
    match event {
        WindowEvent::CloseRequested => queue.close_window(time_s),
        WindowEvent::Focused(has_focus) => queue.focus(*has_focus, time_s),
        WindowEvent::ModifiersChanged(modifiers) => queue.set_modifiers(of_modifiers(modifiers.state())),
        WindowEvent::KeyboardInput { event, is_synthetic, .. } => {
            // Keys that were already down when the window got the focus are no presses.
            if *is_synthetic && event.state == ElementState::Pressed {
                return false;
            }
            let (key, unmodified) = keys(event);
            match event.state {
                ElementState::Pressed => queue.key_press(key, unmodified, time_s),
                ElementState::Released => queue.key_release(key, unmodified, time_s),
            }
        }
        WindowEvent::CursorMoved { .. } => queue.mouse_motion(position_px, time_s),
        WindowEvent::MouseInput { state, button, .. } => {
            let button = match button {
                winit::event::MouseButton::Left => MouseButton::Left,
                winit::event::MouseButton::Middle => MouseButton::Middle,
                winit::event::MouseButton::Right => MouseButton::Right,
                winit::event::MouseButton::Back => MouseButton::Other(4),
                winit::event::MouseButton::Forward => MouseButton::Other(5),
                winit::event::MouseButton::Other(number) => MouseButton::Other(*number),
            };
            match state {
                ElementState::Pressed => queue.mouse_button_press(button, time_s),
                ElementState::Released => queue.mouse_button_release(button, time_s),
            }
        }
        WindowEvent::MouseWheel { delta, .. } => {
            let notches = match delta {
                MouseScrollDelta::LineDelta(right, up) => DVec2::new(f64::from(*right), f64::from(*up)),
                MouseScrollDelta::PixelDelta(px) => DVec2::new(px.x, px.y) / PX_PER_NOTCH,
            };
            queue.mouse_scroll(notches, time_s);
        }
        WindowEvent::Touch(Touch { phase, id, .. }) => {
            let phase = match phase {
                winit::event::TouchPhase::Started => TouchPhase::Began,
                winit::event::TouchPhase::Moved => TouchPhase::Moved,
                winit::event::TouchPhase::Ended => TouchPhase::Ended,
                winit::event::TouchPhase::Cancelled => TouchPhase::Cancelled,
            };
            queue.touch(*id, phase, position_px, time_s);
        }
        WindowEvent::DroppedFile(file) => queue.drop_files(vec![PathBuf::from(file)], time_s),
        _ => return false,
    }
    true
}

/// Returns true for presses: a button or a finger that goes down, the wheel.
pub fn is_press(event: &WindowEvent) -> bool {
    match event {
        WindowEvent::MouseInput { state, .. } => state.is_pressed(),
        WindowEvent::MouseWheel { .. } => true,
        WindowEvent::Touch(touch) => touch.phase == winit::event::TouchPhase::Started,
        _ => false,
    }
}

fn of_modifiers(state: ModifiersState) -> Modifiers {
    Modifiers { shift: state.shift_key(), control: state.control_key(), alt: state.alt_key(), logo: state.super_key() }
}

/// Returns the key in the current layout, and the key at the same position of a US keyboard.
fn keys(event: &KeyEvent) -> (Key, Key) {
    let logical = match &event.logical_key {
        WinitKey::Character(text) => text.chars().next().map_or(Key::Unknown, Key::Char),
        WinitKey::Named(named) => of_named(*named),
        _ => Key::Unknown,
    };
    let unmodified = match event.physical_key {
        PhysicalKey::Code(code) => of_code(code),
        PhysicalKey::Unidentified(_) => Key::Unknown,
    };
    match unmodified {
        Key::Unknown => (logical, logical),
        unmodified => (logical, unmodified),
    }
}

fn of_named(key: NamedKey) -> Key {
    match key {
        NamedKey::Space => Key::SPACE,
        NamedKey::Escape => Key::Escape,
        NamedKey::Enter => Key::Enter,
        NamedKey::Tab => Key::Tab,
        NamedKey::Backspace => Key::Backspace,
        NamedKey::Insert => Key::Insert,
        NamedKey::Delete => Key::Delete,
        NamedKey::Home => Key::Home,
        NamedKey::End => Key::End,
        NamedKey::PageUp => Key::PageUp,
        NamedKey::PageDown => Key::PageDown,
        NamedKey::ArrowLeft => Key::Left,
        NamedKey::ArrowRight => Key::Right,
        NamedKey::ArrowUp => Key::Up,
        NamedKey::ArrowDown => Key::Down,
        NamedKey::Shift => Key::Shift,
        NamedKey::Control => Key::Control,
        NamedKey::Alt | NamedKey::AltGraph => Key::Alt,
        NamedKey::Super => Key::Super,
        NamedKey::F1 => Key::F(1),
        NamedKey::F2 => Key::F(2),
        NamedKey::F3 => Key::F(3),
        NamedKey::F4 => Key::F(4),
        NamedKey::F5 => Key::F(5),
        NamedKey::F6 => Key::F(6),
        NamedKey::F7 => Key::F(7),
        NamedKey::F8 => Key::F(8),
        NamedKey::F9 => Key::F(9),
        NamedKey::F10 => Key::F(10),
        NamedKey::F11 => Key::F(11),
        NamedKey::F12 => Key::F(12),
        _ => Key::Unknown,
    }
}

fn of_code(code: KeyCode) -> Key {
    use KeyCode as C;
    match code {
        C::KeyA => Key::Char('a'),
        C::KeyB => Key::Char('b'),
        C::KeyC => Key::Char('c'),
        C::KeyD => Key::Char('d'),
        C::KeyE => Key::Char('e'),
        C::KeyF => Key::Char('f'),
        C::KeyG => Key::Char('g'),
        C::KeyH => Key::Char('h'),
        C::KeyI => Key::Char('i'),
        C::KeyJ => Key::Char('j'),
        C::KeyK => Key::Char('k'),
        C::KeyL => Key::Char('l'),
        C::KeyM => Key::Char('m'),
        C::KeyN => Key::Char('n'),
        C::KeyO => Key::Char('o'),
        C::KeyP => Key::Char('p'),
        C::KeyQ => Key::Char('q'),
        C::KeyR => Key::Char('r'),
        C::KeyS => Key::Char('s'),
        C::KeyT => Key::Char('t'),
        C::KeyU => Key::Char('u'),
        C::KeyV => Key::Char('v'),
        C::KeyW => Key::Char('w'),
        C::KeyX => Key::Char('x'),
        C::KeyY => Key::Char('y'),
        C::KeyZ => Key::Char('z'),
        C::Digit0 | C::Numpad0 => Key::Char('0'),
        C::Digit1 | C::Numpad1 => Key::Char('1'),
        C::Digit2 | C::Numpad2 => Key::Char('2'),
        C::Digit3 | C::Numpad3 => Key::Char('3'),
        C::Digit4 | C::Numpad4 => Key::Char('4'),
        C::Digit5 | C::Numpad5 => Key::Char('5'),
        C::Digit6 | C::Numpad6 => Key::Char('6'),
        C::Digit7 | C::Numpad7 => Key::Char('7'),
        C::Digit8 | C::Numpad8 => Key::Char('8'),
        C::Digit9 | C::Numpad9 => Key::Char('9'),
        C::Comma => Key::Char(','),
        C::Period | C::NumpadDecimal => Key::Char('.'),
        C::Slash | C::NumpadDivide => Key::Char('/'),
        C::NumpadMultiply => Key::Char('*'),
        C::Minus | C::NumpadSubtract => Key::Char('-'),
        C::NumpadAdd => Key::Char('+'),
        C::Equal => Key::Char('='),
        C::Semicolon => Key::Char(';'),
        C::Quote => Key::Char('\''),
        C::BracketLeft => Key::Char('['),
        C::BracketRight => Key::Char(']'),
        C::Backslash => Key::Char('\\'),
        C::Backquote => Key::Char('`'),
        C::Space => Key::SPACE,
        C::Escape => Key::Escape,
        C::Enter | C::NumpadEnter => Key::Enter,
        C::Tab => Key::Tab,
        C::Backspace => Key::Backspace,
        C::Insert => Key::Insert,
        C::Delete => Key::Delete,
        C::Home => Key::Home,
        C::End => Key::End,
        C::PageUp => Key::PageUp,
        C::PageDown => Key::PageDown,
        C::ArrowLeft => Key::Left,
        C::ArrowRight => Key::Right,
        C::ArrowUp => Key::Up,
        C::ArrowDown => Key::Down,
        C::ShiftLeft | C::ShiftRight => Key::Shift,
        C::ControlLeft | C::ControlRight => Key::Control,
        C::AltLeft | C::AltRight => Key::Alt,
        C::SuperLeft | C::SuperRight => Key::Super,
        C::F1 => Key::F(1),
        C::F2 => Key::F(2),
        C::F3 => Key::F(3),
        C::F4 => Key::F(4),
        C::F5 => Key::F(5),
        C::F6 => Key::F(6),
        C::F7 => Key::F(7),
        C::F8 => Key::F(8),
        C::F9 => Key::F(9),
        C::F10 => Key::F(10),
        C::F11 => Key::F(11),
        C::F12 => Key::F(12),
        _ => Key::Unknown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::events::EventKind;

    #[test]
    fn fingers_keep_ids_and_positions_and_cancelled_touches_are_no_clicks() {
        use winit::event::TouchPhase as Phase;
        let mut queue = EventQueue::default();
        let phases = [Phase::Started, Phase::Moved, Phase::Cancelled, Phase::Started, Phase::Ended];
        for (x, phase) in (0u32..).map(f64::from).zip(phases) {
            let location = winit::dpi::PhysicalPosition::new(x, 7.0);
            let device_id = winit::event::DeviceId::dummy();
            let touch = Touch { device_id, phase, location, force: None, id: 3 };
            assert!(feed_queue(&mut queue, &WindowEvent::Touch(touch), DVec2::new(x, 7.0)));
        }
        let mut events = Vec::new();
        queue.take_frame(&mut events, 0.0);
        let touches: Vec<_> = events
            .iter()
            .filter_map(|event| match event.kind {
                EventKind::Touch { id: 3, phase, position_px } if position_px.y == 7.0 => Some((phase, position_px.x)),
                _ => None,
            })
            .collect();
        use TouchPhase::{Began, Cancelled, Ended, Moved};
        assert_eq!(touches, [(Began, 0.0), (Moved, 1.0), (Cancelled, 2.0), (Began, 3.0), (Ended, 4.0)]);
        let clicks = events.iter().filter(|event| matches!(event.kind, EventKind::DoubleClick(_)));
        assert_eq!(clicks.count(), 0);
    }
}
