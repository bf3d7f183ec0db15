//! [`EventMask`]: a set of kinds of events.

use std::ops::BitOr;

/// A set of kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct EventMask(pub u32);

impl EventMask {
    /// The empty set.
    pub const NONE: Self = Self(0);
    /// `EventKind::Push`.
    pub const PUSH: Self = Self(1);
    /// `EventKind::Release`.
    pub const RELEASE: Self = Self(1 << 1);
    /// `EventKind::DoubleClick`.
    pub const DOUBLE_CLICK: Self = Self(1 << 2);
    /// `EventKind::Drag`.
    pub const DRAG: Self = Self(1 << 3);
    /// `EventKind::Move`.
    pub const MOVE: Self = Self(1 << 4);
    /// `EventKind::KeyDown`.
    pub const KEY_DOWN: Self = Self(1 << 5);
    /// `EventKind::KeyUp`.
    pub const KEY_UP: Self = Self(1 << 6);
    /// `EventKind::Frame`.
    pub const FRAME: Self = Self(1 << 7);
    /// `EventKind::Resize`.
    pub const RESIZE: Self = Self(1 << 8);
    /// `EventKind::Scroll`.
    pub const SCROLL: Self = Self(1 << 9);
    /// `EventKind::Touch`.
    pub const TOUCH: Self = Self(1 << 10);
    /// `EventKind::Drop`.
    pub const DROP: Self = Self(1 << 11);
    /// `EventKind::CloseWindow`.
    pub const CLOSE_WINDOW: Self = Self(1 << 12);
    /// `EventKind::QuitApplication`.
    pub const QUIT_APPLICATION: Self = Self(1 << 13);
    /// `EventKind::Focus`.
    pub const FOCUS: Self = Self(1 << 14);
    /// `EventKind::User`.
    pub const USER: Self = Self(1 << 15);
    /// Every kind.
    pub const ALL: Self = Self(u32::MAX);

    /// Returns true when the sets have a kind in common.
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
