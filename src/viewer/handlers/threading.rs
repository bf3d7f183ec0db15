//! [`ThreadingHandler`]: changes the threads that cull and draw.

use crate::viewer::GuiActionAdapter;
use crate::viewer::ThreadingModel;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;

const KEYS: Bindings<()> = Bindings(&[(&[Key::Char('m')], (), "next threading model")]);

/// Switches to the next threading model; OSG's `ThreadingHandler`.
#[derive(Clone, Copy, Debug, Default)]
pub struct ThreadingHandler;

impl GuiEventHandler for ThreadingHandler {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        if KEYS.action(event).is_none() {
            return false;
        }
        let models = ThreadingModel::ALL;
        let current = models.iter().position(|model| *model == viewer.threading_model()).unwrap_or(0);
        let next = models[(current + 1) % models.len()];
        let text = match viewer.set_threading_model(next) {
            Ok(()) => next.to_string(),
            Err(error) => error.to_string(),
        };
        viewer.notify(text);
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }
}
