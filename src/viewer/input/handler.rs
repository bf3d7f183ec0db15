//! [`GuiEventHandler`]: code that handles events. Called in the event phase, main thread.

use super::action_adapter::GuiActionAdapter;
use crate::viewer::events::{EventMask, GuiEventAdapter, Usage};

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
