//! The event queue: accumulates input state and gives every event a copy of it; OSG's `EventQueue`. Main thread.

use std::path::PathBuf;
use std::time::Instant;

use crossbeam_channel::{Receiver, Sender};
use glam::DVec2;

use super::fingers::{Fingers, MOST_FINGERS};
use super::{EventKind, GuiEventAdapter, InputState, Key, Modifiers, MouseButton, TouchPhase, UserEvent, YOrientation};

/// Longest time between the two presses of a double click.
const DOUBLE_CLICK_S: f64 = 0.4;
/// Farthest the pointer may move between them.
const DOUBLE_CLICK_PX: f64 = 5.0;
/// Events of other threads that may wait for a frame.
const USER_EVENTS: usize = 1024;
/// While more events wait than this (no frame is drawn), pointer motion replaces pointer motion.
const MANY: usize = 1024;

/// Sends the application's own events from any thread.
#[derive(Clone, Debug)]
pub struct UserEvents(Sender<UserEvent>);

impl UserEvents {
    /// Queues an event for the next frame; handed back when 1,024 wait already or the queue is gone.
    pub fn send(&self, event: UserEvent) -> Result<(), UserEvent> {
        self.0.try_send(event).map_err(|e| e.into_inner())
    }
}

/// Collects what happens between two frames.
///
/// Positions are in pixels of the window, in [`InputState::y_orientation`]. Positions that are not finite leave the
/// pointer where it was. Times are seconds since the queue was made; [`Self::time_s`] is now.
#[derive(Debug)]
pub struct EventQueue {
    start: Instant,
    state: InputState,
    fixed_range: bool,
    held: Vec<(Key, Key)>,
    last_push: Option<(MouseButton, f64, DVec2)>,
    pub(super) fingers: Fingers,
    events: Vec<GuiEventAdapter>,
    sender: Sender<UserEvent>,
    from_threads: Receiver<UserEvent>,
}

impl Default for EventQueue {
    fn default() -> Self {
        let (sender, from_threads) = crossbeam_channel::bounded(USER_EVENTS);
        Self {
            start: Instant::now(),
            state: InputState::default(),
            fixed_range: false,
            held: Vec::new(),
            last_push: None,
            fingers: Fingers::default(),
            events: Vec::new(),
            sender,
            from_threads,
        }
    }
}

impl EventQueue {
    /// Seconds since the queue was made.
    pub fn time_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// True when nothing happened since the last frame.
    pub fn is_empty(&self) -> bool {
        self.events.is_empty() && self.from_threads.is_empty()
    }

    /// Pointer, buttons and modifiers after all events so far; OSG's current event state.
    pub fn state(&self) -> &InputState {
        &self.state
    }

    /// True while a key is down, by its place on a US keyboard.
    pub fn is_held(&self, unmodified: Key) -> bool {
        self.held.iter().any(|(_, held)| *held == unmodified)
    }

    /// The pointer's least and greatest position, in pixels; what is not finite or empty leaves the range as it was.
    pub fn set_input_range(&mut self, min: DVec2, max: DVec2) {
        if min.is_finite() && max.is_finite() && min.cmple(max).all() {
            (self.state.min, self.state.max) = (min, max);
            self.clamp();
        }
    }

    /// Keeps the pointer inside the input range from now on; off at first.
    pub fn set_use_fixed_input_range(&mut self, fixed: bool) {
        self.fixed_range = fixed;
        self.clamp();
    }

    /// Which way y counts in the positions that come from now on.
    pub fn set_y_orientation(&mut self, orientation: YOrientation) {
        self.state.position = self.state.position_in(orientation);
        self.state.y_orientation = orientation;
    }

    /// Sends events of the application's own from other threads.
    pub fn user_events(&self) -> UserEvents {
        UserEvents(self.sender.clone())
    }

    /// The pointer moved.
    pub fn mouse_motion(&mut self, position: DVec2, time_s: f64) {
        if !position.is_finite() {
            return;
        }
        self.set_position(position);
        let kind = if self.state.buttons.is_empty() { EventKind::Move } else { EventKind::Drag };
        self.add_motion(kind, time_s);
    }

    /// A button went down; the second time within a short while it is a double click.
    pub fn mouse_button_press(&mut self, button: MouseButton, time_s: f64) {
        self.press(button, time_s, DOUBLE_CLICK_PX);
    }

    /// A button went down; near the place of the last time it may be a double click.
    pub(super) fn press(&mut self, button: MouseButton, time_s: f64, double_within_px: f64) {
        self.state.buttons = self.state.buttons.with(button, true);
        let position = self.state.position;
        let again = self.last_push.take().is_some_and(|(last, at_s, place)| {
            last == button
                && (0.0..DOUBLE_CLICK_S).contains(&(time_s - at_s))
                && place.distance(position) < double_within_px
        });
        if again {
            self.add(EventKind::DoubleClick(button), time_s);
        } else {
            self.last_push = Some((button, time_s, position));
            self.add(EventKind::Push(button), time_s);
        }
    }

    /// A button came up; nothing when it was not down.
    pub fn mouse_button_release(&mut self, button: MouseButton, time_s: f64) {
        if self.state.buttons.contains(button) {
            self.state.buttons = self.state.buttons.with(button, false);
            self.add(EventKind::Release(button), time_s);
        }
    }

    /// The wheel turned, in notches to the right and away from the user.
    pub fn mouse_scroll(&mut self, notches: DVec2, time_s: f64) {
        if notches.is_finite() && notches != DVec2::ZERO {
            self.add(EventKind::Scroll(notches), time_s);
        }
    }

    /// Modifier keys went down or up.
    pub fn set_modifiers(&mut self, modifiers: Modifiers) {
        self.state.modifiers = modifiers;
    }

    /// A key went down, as the layout has it and by its place; down already, it is a repeat.
    pub fn key_press(&mut self, key: Key, unmodified: Key, time_s: f64) {
        let repeat = self.is_held(unmodified);
        if !repeat {
            self.held.push((key, unmodified));
        }
        self.add(EventKind::KeyDown { key, unmodified, repeat }, time_s);
    }

    /// A key came up; nothing when it was not down.
    pub fn key_release(&mut self, key: Key, unmodified: Key, time_s: f64) {
        if let Some(index) = self.held.iter().position(|(_, held)| *held == unmodified) {
            self.held.swap_remove(index);
            self.add(EventKind::KeyUp { key, unmodified }, time_s);
        }
    }

    /// Files were dropped on the window.
    pub fn drop_files(&mut self, files: Vec<PathBuf>, time_s: f64) {
        self.add(EventKind::Drop(files), time_s);
    }

    /// The window has a new size; the input range becomes its pixels. A side of zero counts as one.
    pub fn window_resize(&mut self, size_px: [u32; 2], time_s: f64) {
        let size_px = size_px.map(|side| side.max(1));
        self.set_input_range(DVec2::ZERO, DVec2::new(f64::from(size_px[0]), f64::from(size_px[1])));
        self.add(EventKind::Resize(size_px), time_s);
    }

    /// The user asks the window to close.
    pub fn close_window(&mut self, time_s: f64) {
        self.add(EventKind::CloseWindow, time_s);
    }

    /// The application is asked to end.
    pub fn quit_application(&mut self, time_s: f64) {
        self.add(EventKind::QuitApplication, time_s);
    }

    /// The keyboard's focus came or went; when it goes, what is down comes up first, since its release goes elsewhere.
    pub fn focus(&mut self, has_focus: bool, time_s: f64) {
        if !has_focus {
            self.cancel_fingers(time_s);
            while let Some((key, unmodified)) = self.held.pop() {
                self.add(EventKind::KeyUp { key, unmodified }, time_s);
            }
            for button in [MouseButton::Left, MouseButton::Middle, MouseButton::Right, MouseButton::Other(0)] {
                self.mouse_button_release(button, time_s);
            }
            self.state.modifiers = Modifiers::default();
        }
        self.add(EventKind::Focus(has_focus), time_s);
    }

    /// An event of the application's own.
    pub fn user_event(&mut self, event: UserEvent, time_s: f64) {
        self.add(EventKind::User(event), time_s);
    }

    /// Everything so far, closed by a [`EventKind::Frame`]; called by the viewer once a frame. `events` is emptied
    /// and its memory used again.
    pub fn take_frame(&mut self, events: &mut Vec<GuiEventAdapter>, time_s: f64) {
        while let Ok(event) = self.from_threads.try_recv() {
            self.add(EventKind::User(event), time_s);
        }
        self.add(EventKind::Frame, time_s);
        events.clear();
        std::mem::swap(events, &mut self.events);
    }

    fn clamp(&mut self) {
        if self.fixed_range {
            self.state.position = self.state.position.clamp(self.state.min, self.state.max);
        }
    }

    pub(super) fn set_position(&mut self, position: DVec2) {
        self.state.position = position;
        self.clamp();
    }

    /// The next press is the first one.
    pub(super) fn forget_last_push(&mut self) {
        self.last_push = None;
    }

    /// Adds a motion, in place of the last one of its kind (and finger) where too many events wait.
    pub(super) fn add_motion(&mut self, kind: EventKind, time_s: f64) {
        if self.events.len() > MANY {
            let is_same = |event: &&mut GuiEventAdapter| match (&event.kind, &kind) {
                (EventKind::Touch { id: a, phase: was, .. }, EventKind::Touch { id: b, .. }) => {
                    a == b && *was == TouchPhase::Moved
                }
                (last, next) => std::mem::discriminant(last) == std::mem::discriminant(next),
            };
            // Behind it there are at most the motions of the other fingers and of the pointer.
            let recent = self.events.iter_mut().rev().take(MOST_FINGERS + 1);
            let mut motions = recent.take_while(|event| is_motion(&event.kind));
            if let Some(last) = motions.find(is_same) {
                *last = GuiEventAdapter { kind, time_s, state: self.state, handled: false };
                return;
            }
        }
        self.add(kind, time_s);
    }

    pub(super) fn add(&mut self, kind: EventKind, time_s: f64) {
        self.events.push(GuiEventAdapter { kind, time_s, state: self.state, handled: false });
    }
}

fn is_motion(kind: &EventKind) -> bool {
    matches!(kind, EventKind::Move | EventKind::Drag | EventKind::Touch { phase: TouchPhase::Moved, .. })
}
