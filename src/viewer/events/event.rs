//! [`GuiEventAdapter`]: one event, and the input state just after it; OSG's `GUIEventAdapter`. Plain values.

use std::any::Any;
use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec2;

use super::button::MouseButton;
use super::event_mask::EventMask;
use super::input_state::InputState;
use super::key::Key;
use crate::viewer::ids::{ContextId, SlaveId};

/// A change of a finger on a touch screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TouchPhase {
    /// The finger came down.
    Began,
    /// The finger moved.
    Moved,
    /// The finger was lifted.
    Ended,
    /// The window system cancelled the touch (a palm, a system gesture, a lost focus), so that it is neither a click nor a
    /// throw.
    Cancelled,
}

/// An event of the application.
pub type UserEvent = Arc<dyn Any + Send + Sync>;

/// A kind of event and its data.
#[derive(Clone, Debug)]
pub enum EventKind {
    /// A button went down.
    Push(MouseButton),
    /// A button came up.
    Release(MouseButton),
    /// A button went down for the second time in a short time and distance; sent instead of [`Self::Push`].
    DoubleClick(MouseButton),
    /// The pointer moved with a button down.
    Drag,
    /// The pointer moved with no button down.
    Move,
    /// The wheel turned, in notches to the right and away from the user.
    Scroll(DVec2),
    /// A key went down.
    KeyDown {
        /// The key by the keyboard's layout and the modifiers.
        key: Key,
        /// The key at this position on a US keyboard, without modifiers; for keys that are used by position.
        unmodified: Key,
        /// True when the keyboard repeats a key that is down.
        repeat: bool,
    },
    /// A key came up.
    KeyUp {
        /// See [`Self::KeyDown`].
        key: Key,
        /// See [`Self::KeyDown`].
        unmodified: Key,
    },
    /// A finger came down, moved or was lifted. A single finger also moves the pointer.
    Touch {
        /// Identifies the finger while it is down.
        id: u64,
        /// The change of the finger.
        phase: TouchPhase,
        /// The position in pixels, with y in the queue's direction.
        position_px: DVec2,
    },
    /// Files were dropped on the window.
    Drop(Vec<PathBuf>),
    /// The window has a new size, pixels.
    Resize([u32; 2]),
    /// The user asks the window to close.
    CloseWindow,
    /// The application is asked to end.
    QuitApplication,
    /// The window got the keyboard's focus or lost it. Keys and buttons that are down are released before it is lost.
    Focus(bool),
    /// The last event of each frame's event phase.
    Frame,
    /// An event of the application.
    User(UserEvent),
}

/// The window and camera to which an event belongs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct EventSource {
    /// The context of the window; `None` for events of the application, of frames and of code that names none.
    pub context: Option<ContextId>,
    /// The slave camera under the pointer; `None` for the master camera, and where there is no camera.
    pub slave: Option<SlaveId>,
}

/// An event and the input state just after it.
#[derive(Clone, Debug)]
pub struct GuiEventAdapter {
    /// The kind of event and its data.
    pub kind: EventKind,
    /// The time in seconds of the queue's clock, which is that of
    /// [`FrameStamp::reference_time_s`](crate::viewer::FrameStamp::reference_time_s).
    pub time_s: f64,
    /// The input state just after the event. Positions are in the image of the view's master camera, whatever the camera
    /// under the pointer.
    pub state: InputState,
    /// The window and camera to which the event belongs.
    pub source: EventSource,
    /// True after a handler or the manipulator has handled the event.
    pub handled: bool,
}

impl GuiEventAdapter {
    /// Returns the set with the event's kind.
    pub fn mask(&self) -> EventMask {
        match &self.kind {
            EventKind::Push(_) => EventMask::PUSH,
            EventKind::Release(_) => EventMask::RELEASE,
            EventKind::DoubleClick(_) => EventMask::DOUBLE_CLICK,
            EventKind::Drag => EventMask::DRAG,
            EventKind::Move => EventMask::MOVE,
            EventKind::Scroll(_) => EventMask::SCROLL,
            EventKind::KeyDown { .. } => EventMask::KEY_DOWN,
            EventKind::KeyUp { .. } => EventMask::KEY_UP,
            EventKind::Touch { .. } => EventMask::TOUCH,
            EventKind::Drop(_) => EventMask::DROP,
            EventKind::Resize(_) => EventMask::RESIZE,
            EventKind::CloseWindow => EventMask::CLOSE_WINDOW,
            EventKind::QuitApplication => EventMask::QUIT_APPLICATION,
            EventKind::Focus(_) => EventMask::FOCUS,
            EventKind::Frame => EventMask::FRAME,
            EventKind::User(_) => EventMask::USER,
        }
    }

    /// Returns the key of a key press without modifiers other than Shift; `None` for repeats and while a button of the pointer
    /// is down, because keys then belong to the manipulator.
    pub fn key_pressed(&self) -> Option<Key> {
        let m = self.state.modifiers;
        match self.kind {
            EventKind::KeyDown { key, repeat: false, .. }
                if !(m.control || m.alt || m.logo) && self.state.buttons.is_empty() =>
            {
                Some(key)
            }
            _ => None,
        }
    }

    /// Returns the application's event if it has the type `T`.
    pub fn user<T: Any>(&self) -> Option<&T> {
        match &self.kind {
            EventKind::User(event) => event.downcast_ref(),
            _ => None,
        }
    }
}
