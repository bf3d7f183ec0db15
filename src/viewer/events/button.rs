//! [`MouseButton`]: a button of the pointer.

/// A button of the pointer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MouseButton {
    /// The left button; also a single finger on a touch screen.
    Left,
    /// The middle button or the wheel.
    Middle,
    /// The right button.
    Right,
    /// Another button, with the window system's number.
    Other(u16),
}
