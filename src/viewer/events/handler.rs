//! [`GuiEventHandler`] and [`Bindings`]: code that handles events, and its keys. Called in the event phase, main thread.

use super::event::GuiEventAdapter;
use super::event_mask::EventMask;
use super::key::Key;
use crate::viewer::GuiActionAdapter;

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

/// Handles events before the manipulator does; OSG's `GUIEventHandler`.
pub trait GuiEventHandler {
    /// Handles an event. Returns true when later handlers and the manipulator should ignore it. A handler that is added here
    /// is called from the next event on.
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool;

    /// Returns the kinds of events that this handler is called for.
    fn event_mask(&self) -> EventMask {
        EventMask::ALL
    }

    /// Returns the kinds of events that this handler is not called for after another one handled them; all by default.
    /// OSG's handlers check `getHandled` themselves.
    fn ignore_handled_mask(&self) -> EventMask {
        EventMask::ALL
    }

    /// Returns the handler's keys, for the help.
    fn usage(&self) -> Vec<Usage> {
        Vec::new()
    }

    /// Returns true while the handler shows something over the image.
    fn shows_overlay(&self) -> bool {
        false
    }

    /// Lays out the handler's page with egui. Called after the events of a frame while [`Self::shows_overlay`] returns true.
    #[cfg(feature = "window")]
    fn lay_out(&mut self, ui: &egui::Context, viewer: &GuiActionAdapter<'_>) {
        let _ = (ui, viewer);
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
