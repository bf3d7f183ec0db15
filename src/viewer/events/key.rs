//! [`Key`]: a key of the keyboard.

/// A key of the keyboard.
///
/// Characters are as typed: letters with Shift are capitals. Letters that name positions (see
/// [`EventKind::KeyDown`](super::EventKind::KeyDown)) are lower case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Key {
    /// A key that types a character, including the space bar.
    Char(char),
    /// A function key, counted from 1.
    F(u8),
    /// Escape.
    Escape,
    /// Return and the keypad's Enter.
    Enter,
    /// Tab.
    Tab,
    /// Backspace.
    Backspace,
    /// Insert.
    Insert,
    /// Delete.
    Delete,
    /// Home.
    Home,
    /// End.
    End,
    /// Page up.
    PageUp,
    /// Page down.
    PageDown,
    /// Arrow to the left.
    Left,
    /// Arrow to the right.
    Right,
    /// Arrow up.
    Up,
    /// Arrow down.
    Down,
    /// Either Shift.
    Shift,
    /// Either Control.
    Control,
    /// Either Alt or Option.
    Alt,
    /// Either Windows or Command key.
    Super,
    /// Any other key.
    Unknown,
}

impl Key {
    /// The space bar.
    pub const SPACE: Self = Self::Char(' ');
}

impl std::fmt::Display for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Char(' ') => f.write_str("Space"),
            Self::Char(c) if c.is_uppercase() => write!(f, "Shift+{c}"),
            Self::Char(c) => write!(f, "{}", c.to_uppercase()),
            Self::F(number) => write!(f, "F{number}"),
            Self::Escape => f.write_str("Esc"),
            Self::PageUp => f.write_str("Page up"),
            Self::PageDown => f.write_str("Page down"),
            other => write!(f, "{other:?}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_readable_names() {
        let names = [Key::Char('w'), Key::Char('W'), Key::Char('<'), Key::SPACE, Key::F(12), Key::Left, Key::PageUp];
        assert_eq!(names.map(|k| k.to_string()), ["W", "Shift+W", "<", "Space", "F12", "Left", "Page up"]);
    }
}
