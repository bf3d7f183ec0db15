//! [`Bindings`]: the keys of a handler, with their help.

use super::event::GuiEventAdapter;
use super::key::Key;

/// A line of the help: keys and their action.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Usage {
    /// The keys or gestures, in readable form.
    pub keys: String,
    /// The action, without a full stop.
    pub does: &'static str,
}

impl Usage {
    pub(in crate::viewer) fn new(keys: &str, does: &'static str) -> Self {
        Self { keys: keys.to_owned(), does }
    }
}

/// Keys, their actions and a line of help for each, declared once for handling and for the help.
#[derive(Clone, Debug)]
pub struct Bindings<A: 'static>(pub &'static [(&'static [Key], A, &'static str)]);

impl<A: Copy> Bindings<A> {
    /// Returns the action of a key event.
    pub fn action(&self, event: &GuiEventAdapter) -> Option<A> {
        let pressed = event.key_pressed()?;
        self.0.iter().find(|(keys, ..)| keys.contains(&pressed)).map(|(_, action, _)| *action)
    }

    /// Returns the lines of help.
    pub fn usage(&self) -> Vec<Usage> {
        let names = |keys: &[Key]| keys.iter().map(Key::to_string).collect::<Vec<_>>().join(", ");
        self.0.iter().map(|(keys, _, does)| Usage { keys: names(keys), does }).collect()
    }
}
