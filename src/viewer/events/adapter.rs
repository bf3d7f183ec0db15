//! One event: what happened, when, and the state of pointer and keys just after; OSG's `GUIEventAdapter`.

use std::any::Any;
use std::ops::BitOr;
use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec2;

use super::Key;

/// A button of the pointer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MouseButton {
    /// The first button; a single finger on a touch screen counts as it.
    Left,
    /// The wheel's button.
    Middle,
    /// The second button.
    Right,
    /// Any other, by the window system's number.
    Other(u16),
}

/// Buttons held down; those beyond the three of old count as one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ButtonMask(u8);

impl ButtonMask {
    /// True when none is down.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// True while the button is down.
    pub fn contains(self, button: MouseButton) -> bool {
        self.0 & Self::bit(button) != 0
    }

    /// With a button down or up.
    #[must_use]
    pub fn with(self, button: MouseButton, down: bool) -> Self {
        Self(if down { self.0 | Self::bit(button) } else { self.0 & !Self::bit(button) })
    }

    fn bit(button: MouseButton) -> u8 {
        match button {
            MouseButton::Left => 1,
            MouseButton::Middle => 2,
            MouseButton::Right => 4,
            MouseButton::Other(_) => 8,
        }
    }
}

/// Modifier keys held down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Modifiers {
    /// Shift.
    pub shift: bool,
    /// Control.
    pub control: bool,
    /// Alt or Option.
    pub alt: bool,
    /// Windows or Command key.
    pub logo: bool,
}

/// Which way y counts in pointer positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum YOrientation {
    /// From the upper edge, as window systems count.
    #[default]
    IncreasingDownwards,
    /// From the lower edge, as OSG's viewports count.
    IncreasingUpwards,
}

/// What a touch point does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TouchPhase {
    /// Came down.
    Began,
    /// Moved.
    Moved,
    /// Lifted.
    Ended,
    /// The window system took it away (a palm, a gesture of its own, the focus went): what it did is no click and no
    /// throw.
    Cancelled,
}

/// An event of the application's own.
pub type UserEvent = Arc<dyn Any + Send + Sync>;

/// What happened.
#[derive(Clone, Debug)]
pub enum EventKind {
    /// A button went down.
    Push(MouseButton),
    /// A button came up.
    Release(MouseButton),
    /// A button went down a second time within a short while at the same place; takes the place of
    /// [`Self::Push`].
    DoubleClick(MouseButton),
    /// The pointer moved with a button down.
    Drag,
    /// The pointer moved with no button down.
    Move,
    /// The wheel turned: notches to the right and away from the user.
    Scroll(DVec2),
    /// A key went down.
    KeyDown {
        /// What the keyboard's layout and the modifiers make of it.
        key: Key,
        /// The key's place on a US keyboard, without modifiers: for keys that are used by their position.
        unmodified: Key,
        /// The keyboard repeats it by itself.
        repeat: bool,
    },
    /// A key came up.
    KeyUp {
        /// As for [`Self::KeyDown`].
        key: Key,
        /// As for [`Self::KeyDown`].
        unmodified: Key,
    },
    /// A finger; one that is down alone moves the pointer too.
    Touch {
        /// Tells fingers apart while they are down.
        id: u64,
        /// What it does.
        phase: TouchPhase,
        /// Pixels, in the queue's orientation.
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
    /// The keyboard's focus came or went; before it goes, keys and buttons that are down come up.
    Focus(bool),
    /// A frame begins: the last event of each frame's event phase.
    Frame,
    /// The application's own.
    User(UserEvent),
}

/// Kinds of events, as a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct EventMask(pub u32);

impl EventMask {
    /// No kind.
    pub const NONE: Self = Self(0);
    /// [`EventKind::Push`].
    pub const PUSH: Self = Self(1);
    /// [`EventKind::Release`].
    pub const RELEASE: Self = Self(1 << 1);
    /// [`EventKind::DoubleClick`].
    pub const DOUBLE_CLICK: Self = Self(1 << 2);
    /// [`EventKind::Drag`].
    pub const DRAG: Self = Self(1 << 3);
    /// [`EventKind::Move`].
    pub const MOVE: Self = Self(1 << 4);
    /// [`EventKind::KeyDown`].
    pub const KEY_DOWN: Self = Self(1 << 5);
    /// [`EventKind::KeyUp`].
    pub const KEY_UP: Self = Self(1 << 6);
    /// [`EventKind::Frame`].
    pub const FRAME: Self = Self(1 << 7);
    /// [`EventKind::Resize`].
    pub const RESIZE: Self = Self(1 << 8);
    /// [`EventKind::Scroll`].
    pub const SCROLL: Self = Self(1 << 9);
    /// [`EventKind::Touch`].
    pub const TOUCH: Self = Self(1 << 10);
    /// [`EventKind::Drop`].
    pub const DROP: Self = Self(1 << 11);
    /// [`EventKind::CloseWindow`].
    pub const CLOSE_WINDOW: Self = Self(1 << 12);
    /// [`EventKind::QuitApplication`].
    pub const QUIT_APPLICATION: Self = Self(1 << 13);
    /// [`EventKind::Focus`].
    pub const FOCUS: Self = Self(1 << 14);
    /// [`EventKind::User`].
    pub const USER: Self = Self(1 << 15);
    /// Everything.
    pub const ALL: Self = Self(u32::MAX);
    /// Everything that the pointer does.
    pub const POINTER: Self = Self(1 | 1 << 1 | 1 << 2 | 1 << 3 | 1 << 4 | 1 << 9 | 1 << 10);

    /// True when the sets share a kind.
    pub const fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

impl BitOr for EventMask {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Pointer, buttons, modifiers and input range; every event carries them as they are just after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputState {
    /// Pointer position in pixels.
    pub position: DVec2,
    /// Least position of the pointer.
    pub min: DVec2,
    /// Greatest position of the pointer.
    pub max: DVec2,
    /// Which way y counts in these positions.
    pub y_orientation: YOrientation,
    /// Buttons held down.
    pub buttons: ButtonMask,
    /// Modifier keys held down.
    pub modifiers: Modifiers,
}

impl Default for InputState {
    fn default() -> Self {
        Self {
            position: DVec2::ZERO,
            min: DVec2::ZERO,
            max: DVec2::ONE,
            y_orientation: YOrientation::default(),
            buttons: ButtonMask::default(),
            modifiers: Modifiers::default(),
        }
    }
}

impl InputState {
    /// The pointer within the input range: -1 at the left and lower edge, 1 at the right and upper edge; 0 where the
    /// range has no extent.
    pub fn normalized(&self) -> DVec2 {
        let size = self.max - self.min;
        let share = |at: f64, min: f64, size: f64| if size > 0.0 { 2.0 * (at - min) / size - 1.0 } else { 0.0 };
        let y = share(self.position.y, self.min.y, size.y);
        DVec2::new(
            share(self.position.x, self.min.x, size.x),
            match self.y_orientation {
                YOrientation::IncreasingDownwards => -y,
                YOrientation::IncreasingUpwards => y,
            },
        )
    }

    /// The pointer's position with y counted the other or the same way.
    pub fn position_in(&self, orientation: YOrientation) -> DVec2 {
        if orientation == self.y_orientation {
            self.position
        } else {
            DVec2::new(self.position.x, self.max.y - (self.position.y - self.min.y))
        }
    }
}

/// One event.
#[derive(Clone, Debug)]
pub struct GuiEventAdapter {
    /// What happened.
    pub kind: EventKind,
    /// Seconds since the queue's start.
    pub time_s: f64,
    /// The state just after.
    pub state: InputState,
    /// A handler has answered it.
    pub handled: bool,
}

impl GuiEventAdapter {
    /// The kind as a set of one.
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

    /// The key that went down by itself or with Shift; none while Control, Alt or the logo key or a button of the
    /// pointer is down (keys are the manipulator's then), nor for repeats.
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

    /// The application's own event, when it is of a type.
    pub fn user<T: Any>(&self) -> Option<&T> {
        match &self.kind {
            EventKind::User(event) => event.downcast_ref(),
            _ => None,
        }
    }
}
