//! [`HandlerList`]: the event handlers of a view, in the order they are called.

use super::handler::GuiEventHandler;

/// Event handlers, each of which may change the list while it runs.
///
/// The handler that runs is taken out of its slot, so that it can be given the view that owns the list.
#[derive(Default)]
pub(super) struct HandlerList {
    slots: Vec<Option<Box<dyn GuiEventHandler>>>,
}

impl HandlerList {
    /// Appends a handler.
    pub fn add(&mut self, handler: Box<dyn GuiEventHandler>) {
        self.slots.push(Some(handler));
    }

    /// Removes all handlers; a handler that runs is dropped when it returns.
    pub fn clear(&mut self) {
        self.slots.clear();
    }

    /// Returns the number of slots.
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Returns the handlers that are in their slots.
    pub fn iter(&self) -> impl Iterator<Item = &dyn GuiEventHandler> {
        self.slots.iter().flatten().map(|handler| &**handler)
    }

    /// Takes a handler out of its slot to run it.
    pub fn take(&mut self, index: usize) -> Option<Box<dyn GuiEventHandler>> {
        self.slots.get_mut(index).and_then(Option::take)
    }

    /// Puts a handler back after it ran; drops it when the list was cleared in the meantime.
    pub fn put_back(&mut self, index: usize, handler: Box<dyn GuiEventHandler>) {
        if let Some(slot) = self.slots.get_mut(index).filter(|slot| slot.is_none()) {
            *slot = Some(handler);
        }
    }
}
