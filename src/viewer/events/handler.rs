//! Who answers events; OSG's `GUIEventHandler`. Called in the event phase, on the main thread.

use super::{EventMask, GuiEventAdapter, Key};
use crate::viewer::GuiActionAdapter;

/// A line of the help: keys and what they do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Usage {
    /// The keys or gestures, as people call them.
    pub keys: String,
    /// What they do, without a full stop.
    pub does: &'static str,
}

/// Answers events before the manipulator does.
pub trait GuiEventHandler {
    /// Takes one event; true when it is answered, so that neither later handlers nor the manipulator need to. A handler
    /// that is added here is called from the next event on.
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool;

    /// The kinds that this handler is called for.
    fn event_mask(&self) -> EventMask {
        EventMask::ALL
    }

    /// The kinds that it is not called for once they are answered. OSG's handlers look at `getHandled` themselves;
    /// here all kinds are ignored unless a handler says otherwise.
    fn ignore_handled_mask(&self) -> EventMask {
        EventMask::ALL
    }

    /// Its keys, for the help.
    fn usage(&self) -> Vec<Usage> {
        Vec::new()
    }

    /// True while it has something to show over the picture.
    fn shows_overlay(&self) -> bool {
        false
    }

    /// Lays out what it shows; called after the events of a frame when any handler [`Self::shows_overlay`].
    #[cfg(feature = "window")]
    fn lay_out(&mut self, ui: &egui::Context, viewer: &GuiActionAdapter<'_>) {
        let _ = (ui, viewer);
    }
}

/// Keys and the actions they stand for, with a line of help each: declared once, for both.
#[derive(Clone, Debug)]
pub struct Bindings<A: 'static>(pub &'static [(&'static [Key], A, &'static str)]);

impl<A: Copy> Bindings<A> {
    /// What a key event asks for.
    pub fn action(&self, event: &GuiEventAdapter) -> Option<A> {
        let pressed = event.key_pressed()?;
        self.0.iter().find(|(keys, ..)| keys.contains(&pressed)).map(|(_, action, _)| *action)
    }

    /// The help.
    pub fn usage(&self) -> Vec<Usage> {
        let names = |keys: &[Key]| keys.iter().map(Key::to_string).collect::<Vec<_>>().join(", ");
        self.0.iter().map(|(keys, _, does)| Usage { keys: names(keys), does }).collect()
    }
}
