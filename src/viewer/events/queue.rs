//! [`EventQueue`]: collects events between two frames, each with a copy of the input state; OSG's `EventQueue`.
//!
//! Main thread, except [`UserEvents`], through which any thread sends events of the application.

use std::path::PathBuf;

use crossbeam_channel::{Receiver, Sender};
use glam::DVec2;

use super::button::MouseButton;
use super::event::{EventKind, EventSource, GuiEventAdapter, TouchPhase, UserEvent};
use super::fingers::{Fingers, MAX_FINGERS};
use super::input_state::{InputState, Modifiers, YOrientation};
use super::key::Key;
use crate::viewer::clock::ReferenceClock;

/// The maximum time between the two presses of a double click, seconds.
const DOUBLE_CLICK_S: f64 = 0.4;
/// The maximum distance between the two presses of a double click, pixels.
const DOUBLE_CLICK_PX: f64 = 5.0;
/// The capacity of the channel for events from other threads.
const MAX_USER_EVENTS: usize = 1024;
/// The number of queued events above which a pointer motion replaces the previous one. The queue grows that long only while
/// no frames are drawn.
const MERGE_MOTION_ABOVE: usize = 1024;

/// Sends events of the application from any thread.
#[derive(Clone, Debug)]
pub struct UserEvents(Sender<UserEvent>);

impl UserEvents {
    /// Queues an event for the next frame. Returns the event when 1,024 are queued already or the queue was dropped.
    pub fn send(&self, event: UserEvent) -> Result<(), UserEvent> {
        self.0.try_send(event).map_err(|e| e.into_inner())
    }
}

/// Collects the events between two frames.
///
/// Positions are in pixels of the view, in [`InputState::y_orientation`]; positions that are not finite are ignored. Times are
/// seconds of [`FrameStamp::reference_time_s`](crate::viewer::FrameStamp::reference_time_s), the same for all views of a
/// viewer; in a queue without a viewer, seconds since it was created. [`Self::time_s`] is the current time.
#[derive(Debug)]
pub struct EventQueue {
    clock: ReferenceClock,
    state: InputState,
    source: EventSource,
    fixed_range: bool,
    /// The keys that are down: by the layout, and by position.
    held: Vec<(Key, Key)>,
    /// Button, time in seconds and position in pixels of the last press.
    last_push: Option<(MouseButton, f64, DVec2)>,
    pub(super) fingers: Fingers,
    events: Vec<GuiEventAdapter>,
    sender: Sender<UserEvent>,
    from_threads: Receiver<UserEvent>,
}

impl Default for EventQueue {
    fn default() -> Self {
        Self::with_clock(ReferenceClock::started())
    }
}

impl EventQueue {
    /// Creates the queue of a view.
    pub(in crate::viewer) fn with_clock(clock: ReferenceClock) -> Self {
        let (sender, from_threads) = crossbeam_channel::bounded(MAX_USER_EVENTS);
        Self {
            clock,
            state: InputState::default(),
            source: EventSource::default(),
            fixed_range: false,
            held: Vec::new(),
            last_push: None,
            fingers: Fingers::default(),
            events: Vec::new(),
            sender,
            from_threads,
        }
    }

    /// Returns the seconds since the first frame of the viewer, 0 before it.
    pub fn time_s(&self) -> f64 {
        self.clock.seconds()
    }

    /// Returns true while a button or a finger is down.
    pub fn is_pressed(&self) -> bool {
        !self.state.buttons.is_empty() || !self.fingers.down.is_empty()
    }

    /// Sets the window and camera of the events that are queued from now on.
    pub fn set_source(&mut self, source: EventSource) {
        self.source = source;
    }

    /// Returns the window and camera of the last event.
    pub fn source(&self) -> EventSource {
        self.source
    }

    /// Notes that the application has moved the pointer: the state has its new position, and there is no event.
    pub fn mouse_warped(&mut self, position: DVec2) {
        if position.is_finite() {
            self.set_position(position);
            self.forget_last_push();
        }
    }

    /// Returns true when no event was queued since the last frame.
    pub fn is_empty(&self) -> bool {
        self.events.is_empty() && self.from_threads.is_empty()
    }

    /// Returns pointer, buttons and modifiers after all events so far; OSG's current event state.
    pub fn state(&self) -> &InputState {
        &self.state
    }

    /// Returns true while a key is down, by its position on a US keyboard.
    pub fn is_held(&self, unmodified: Key) -> bool {
        self.held.iter().any(|(_, held)| *held == unmodified)
    }

    /// Sets the pointer's minimum and maximum position, pixels. A range that is not finite, or has min above max, is ignored.
    pub fn set_input_range(&mut self, min: DVec2, max: DVec2) {
        if min.is_finite() && max.is_finite() && min.cmple(max).all() {
            (self.state.min, self.state.max) = (min, max);
            self.clamp();
        }
    }

    /// Clamps the pointer to the input range from now on; off by default.
    pub fn set_use_fixed_input_range(&mut self, fixed: bool) {
        self.fixed_range = fixed;
        self.clamp();
    }

    /// Sets the direction of y in the positions passed from now on.
    pub fn set_y_orientation(&mut self, orientation: YOrientation) {
        self.state.position = self.state.position_in(orientation);
        self.state.y_orientation = orientation;
    }

    /// Returns a sender for events of the application from other threads.
    pub fn user_events(&self) -> UserEvents {
        UserEvents(self.sender.clone())
    }

    /// Queues a motion of the pointer.
    pub fn mouse_motion(&mut self, position: DVec2, time_s: f64) {
        if !position.is_finite() {
            return;
        }
        self.set_position(position);
        let kind = if self.state.buttons.is_empty() { EventKind::Move } else { EventKind::Drag };
        self.add_motion(kind, time_s);
    }

    /// Queues a press of a button, or a double click when it is the second press in a short time.
    pub fn mouse_button_press(&mut self, button: MouseButton, time_s: f64) {
        self.press(button, time_s, DOUBLE_CLICK_PX);
    }

    /// Queues a press, which is a double click within a distance of the last press.
    pub(super) fn press(&mut self, button: MouseButton, time_s: f64, double_within_px: f64) {
        self.state.buttons = self.state.buttons.with(button, true);
        let position = self.state.position;
        let again = self.last_push.take().is_some_and(|(last, at_s, last_position)| {
            last == button
                && (0.0..DOUBLE_CLICK_S).contains(&(time_s - at_s))
                && last_position.distance(position) < double_within_px
        });
        if again {
            self.add(EventKind::DoubleClick(button), time_s);
        } else {
            self.last_push = Some((button, time_s, position));
            self.add(EventKind::Push(button), time_s);
        }
    }

    /// Queues a release of a button; ignored when the button is not down.
    pub fn mouse_button_release(&mut self, button: MouseButton, time_s: f64) {
        if self.state.buttons.contains(button) {
            self.state.buttons = self.state.buttons.with(button, false);
            self.add(EventKind::Release(button), time_s);
        }
    }

    /// Queues a turn of the wheel, in notches to the right and away from the user.
    pub fn mouse_scroll(&mut self, notches: DVec2, time_s: f64) {
        if notches.is_finite() && notches != DVec2::ZERO {
            self.add(EventKind::Scroll(notches), time_s);
        }
    }

    /// Sets the modifier keys that are down.
    pub fn set_modifiers(&mut self, modifiers: Modifiers) {
        self.state.modifiers = modifiers;
    }

    /// Queues a press of a key, by the layout and by position. When the key is down already it is a repeat.
    pub fn key_press(&mut self, key: Key, unmodified: Key, time_s: f64) {
        let repeat = self.is_held(unmodified);
        if !repeat {
            self.held.push((key, unmodified));
        }
        self.add(EventKind::KeyDown { key, unmodified, repeat }, time_s);
    }

    /// Queues a release of a key; ignored when the key is not down.
    pub fn key_release(&mut self, key: Key, unmodified: Key, time_s: f64) {
        if let Some(index) = self.held.iter().position(|(_, held)| *held == unmodified) {
            self.held.swap_remove(index);
            self.add(EventKind::KeyUp { key, unmodified }, time_s);
        }
    }

    /// Queues files that were dropped on the window.
    pub fn drop_files(&mut self, files: Vec<PathBuf>, time_s: f64) {
        self.add(EventKind::Drop(files), time_s);
    }

    /// Queues a resize; the input range becomes the window's pixels. A side of 0 counts as 1.
    pub fn window_resize(&mut self, size_px: [u32; 2], time_s: f64) {
        let size_px = size_px.map(|side| side.max(1));
        self.set_input_range(DVec2::ZERO, DVec2::new(f64::from(size_px[0]), f64::from(size_px[1])));
        self.add(EventKind::Resize(size_px), time_s);
    }

    /// Queues the user's request to close the window.
    pub fn close_window(&mut self, time_s: f64) {
        self.add(EventKind::CloseWindow, time_s);
    }

    /// Queues a request to end the application.
    pub fn quit_application(&mut self, time_s: f64) {
        self.add(EventKind::QuitApplication, time_s);
    }

    /// Queues a change of the keyboard's focus. When it is lost, keys, buttons and fingers are released first, because another
    /// window receives their release.
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

    /// Queues an event of the application.
    pub fn user_event(&mut self, event: UserEvent, time_s: f64) {
        self.add_without_source(EventKind::User(event), time_s);
    }

    /// Replaces the content of `events` by the queued events and a final [`EventKind::Frame`]. The viewer calls it once per
    /// frame with the same list, whose memory is reused.
    pub fn take_frame(&mut self, events: &mut Vec<GuiEventAdapter>, time_s: f64) {
        while let Ok(event) = self.from_threads.try_recv() {
            self.add_without_source(EventKind::User(event), time_s);
        }
        self.add_without_source(EventKind::Frame, time_s);
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

    /// Makes the next press a first press, which cannot be a double click.
    pub(super) fn forget_last_push(&mut self) {
        self.last_push = None;
    }

    /// Queues a motion. When too many events are queued it replaces the last motion of its kind and finger.
    pub(super) fn add_motion(&mut self, kind: EventKind, time_s: f64) {
        if self.events.len() > MERGE_MOTION_ABOVE {
            let is_same = |event: &&mut GuiEventAdapter| match (&event.kind, &kind) {
                (EventKind::Touch { id: a, phase: was, .. }, EventKind::Touch { id: b, .. }) => {
                    a == b && *was == TouchPhase::Moved
                }
                (last, next) => std::mem::discriminant(last) == std::mem::discriminant(next),
            };
            // At most the motions of the other fingers and of the pointer were queued after it.
            let recent = self.events.iter_mut().rev().take(MAX_FINGERS + 1);
            let mut motions = recent.take_while(|event| is_motion(&event.kind));
            if let Some(last) = motions.find(is_same) {
                *last = GuiEventAdapter { kind, time_s, state: self.state, source: self.source, handled: false };
                return;
            }
        }
        self.add(kind, time_s);
    }

    pub(super) fn add(&mut self, kind: EventKind, time_s: f64) {
        self.events.push(GuiEventAdapter { kind, time_s, state: self.state, source: self.source, handled: false });
    }

    /// Queues an event that belongs to no window.
    fn add_without_source(&mut self, kind: EventKind, time_s: f64) {
        let source = EventSource::default();
        self.events.push(GuiEventAdapter { kind, time_s, state: self.state, source, handled: false });
    }
}

fn is_motion(kind: &EventKind) -> bool {
    matches!(kind, EventKind::Move | EventKind::Drag | EventKind::Touch { phase: TouchPhase::Moved, .. })
}
