//! Who draws.

use super::Viewer;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, GuiEventHandler, Key, Usage};

const KEYS: Bindings<()> = Bindings(&[(&[Key::Char('m')], (), "next threading model")]);

/// Changes to the next threading model and says which that is; an error is shown to the user.
pub type SwitchThreading = Box<dyn FnMut(&mut Viewer) -> Result<String, crate::viewer::ViewerError>>;

/// Switches the threading model by what it is given; OSG's `ThreadingHandler`.
pub struct ThreadingHandler {
    switch: SwitchThreading,
}

impl ThreadingHandler {
    /// A handler that calls `switch`.
    pub fn new(switch: SwitchThreading) -> Self {
        Self { switch }
    }
}

impl GuiEventHandler for ThreadingHandler {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut Viewer) -> bool {
        if KEYS.action(event).is_none() {
            return false;
        }
        match (self.switch)(viewer) {
            Ok(model) => viewer.notify(model),
            Err(error) => viewer.notify(error.to_string()),
        }
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }
}
