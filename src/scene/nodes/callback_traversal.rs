//! The traversals that call update and event callbacks. Main thread, event and update phases.

use std::any::Any;

use super::callback::{EventCallback, NodeCallback, Traverse, UpdateCallback, UpdateInfo};
use crate::scene::callback_pages::CallbackKind;
use crate::scene::error::SceneError;
use crate::scene::graph::Scene;
use crate::scene::id::{NodeId, PageId};
use crate::scene::pages::Page;
use crate::scene::sparse_list::SparseList;

impl Scene {
    /// Calls the update callbacks of all nodes, depth-first in each page. Returns the number of nodes visited. Part of the
    /// update phase, once a frame.
    pub fn update_traversal(&mut self, info: &UpdateInfo) -> usize {
        self.traverse_callbacks(CallbackKind::Update, Page::update_callbacks, info)
    }

    /// Calls the event callbacks of all nodes, depth-first in each page. Returns the number of nodes visited. Part of the
    /// event phase, once an event.
    pub fn event_traversal(&mut self, event: &dyn Any) -> usize {
        self.traverse_callbacks(CallbackKind::Event, Page::event_callbacks, event)
    }

    /// Returns true if some node has an update callback.
    pub fn has_update_callbacks(&self) -> bool {
        self.has_page_with(CallbackKind::Update, |page| !page.update_callbacks().is_empty())
    }

    /// Returns true if some node has an event callback.
    pub fn has_event_callbacks(&self) -> bool {
        self.has_page_with(CallbackKind::Event, |page| !page.event_callbacks().is_empty())
    }

    fn has_page_with(&self, kind: CallbackKind, has: impl Fn(&Page) -> bool) -> bool {
        self.callback_pages().pages(kind).iter().any(|at| self.page_at(*at).is_some_and(&has))
    }

    /// Replaces the update callback of a node; `None` removes it.
    pub fn set_update_callback(&mut self, node: NodeId, callback: Option<UpdateCallback>) -> Result<(), SceneError> {
        self.page_of_node(node)?.update_callbacks_mut().set(node.index, callback);
        self.list_callbacks(node.page);
        Ok(())
    }

    /// Replaces the event callback of a node; `None` removes it.
    pub fn set_event_callback(&mut self, node: NodeId, callback: Option<EventCallback>) -> Result<(), SceneError> {
        self.page_of_node(node)?.event_callbacks_mut().set(node.index, callback);
        self.list_callbacks(node.page);
        Ok(())
    }

    /// Lists a page whose callbacks have changed. A page without callbacks of one kind keeps its position in that order
    /// until it has none of the other kind either.
    fn list_callbacks(&mut self, id: PageId) {
        let mut pages = std::mem::take(self.callback_pages_mut());
        if let Some(page) = self.page(id) {
            let is_below = |other: u32| self.is_attached_below(self.page_id_at(other), id);
            let (updates, events) = (!page.update_callbacks().is_empty(), !page.event_callbacks().is_empty());
            if updates {
                pages.insert(CallbackKind::Update, id.slot, is_below);
            }
            if events {
                pages.insert(CallbackKind::Event, id.slot, is_below);
            }
            if !updates && !events {
                pages.remove(id.slot);
            }
        }
        *self.callback_pages_mut() = pages;
    }

    fn traverse_callbacks<I: ?Sized + 'static>(
        &mut self,
        kind: CallbackKind,
        list: fn(&Page) -> &SparseList<NodeCallback<I>>,
        info: &I,
    ) -> usize {
        self.callback_pages_mut().start(kind);
        let mut visited = 0;
        // Callbacks may add, remove and change pages and callbacks, so the next one is looked up each time.
        while let Some(page_at) = self.callback_pages_mut().next(kind) {
            let page_id = self.page_id_at(page_at);
            let is_skipped = self.callback_pages().skips_any() && self.is_below_skipped(page_id);
            let mut next_node = if is_skipped { u32::MAX } else { 0 };
            while let Some((node, callback)) = self.page(page_id).and_then(|p| list(p).at_or_after(next_node)).cloned()
            {
                visited += 1;
                next_node = node + 1;
                if callback.call(self, NodeId { page: page_id, index: node }, info) == Traverse::Skip
                    && let Some(skip) = self.page(page_id).and_then(|p| p.nodes().get(node as usize)).map(|r| r.skip)
                {
                    next_node = node + skip;
                    self.callback_pages_mut().skip(page_at, node..next_node);
                }
            }
        }
        visited
    }

    /// Returns true if a page is somewhere below another.
    fn is_attached_below(&self, page: PageId, above: PageId) -> bool {
        self.slots_above(page).any(|slot| slot.page == above)
    }

    /// Returns true if a page is somewhere below a subtree that the traversal leaves out.
    fn is_below_skipped(&self, page: PageId) -> bool {
        self.slots_above(page).any(|slot| self.callback_pages().is_skipped(slot.page.slot, slot.index))
    }

    /// Returns the slot that a page is attached to, then the slot of the page that holds it, and so on.
    fn slots_above(&self, page: PageId) -> impl Iterator<Item = NodeId> + '_ {
        std::iter::successors(self.slot_of(page), |slot| self.slot_of(slot.page))
    }
}
