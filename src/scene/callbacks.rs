//! Update and event callbacks of nodes, and the traversals that call them. Main thread, event and update phases.
//!
//! A page lists its nodes with callbacks, and the scene its pages with such nodes, so that a traversal visits the
//! callbacks and nothing else: what OSG's counts of children that require traversal come to in flat pages.

use std::any::Any;
use std::sync::{Arc, Mutex};

use super::error::SceneError;
use super::graph::Scene;
use super::page::Page;
use super::{NodeId, PageId};

/// What comes after a node's callback.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Traverse {
    /// The callbacks below it, as if it had called OSG's `traverse`.
    #[default]
    Below,
    /// Those below it, in pages that hang there too, are left out this time.
    Skip,
}

/// What an update callback is told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UpdateInfo {
    /// The frame.
    pub frame: u32,
    /// Seconds since the first frame.
    pub reference_time_s: f64,
    /// Seconds in the application's time.
    pub simulation_time_s: f64,
}

type OnUpdate = dyn FnMut(&mut Scene, NodeId, &UpdateInfo) -> Traverse + Send;
type OnEvent = dyn FnMut(&mut Scene, NodeId, &dyn Any) -> Traverse + Send;

/// Called for its node once a frame. Clones share what the closure holds.
#[derive(Clone)]
pub struct UpdateCallback(Arc<Mutex<OnUpdate>>);

impl UpdateCallback {
    /// A callback that may change the scene.
    pub fn new(call: impl FnMut(&mut Scene, NodeId, &UpdateInfo) -> Traverse + Send + 'static) -> Self {
        Self(Arc::new(Mutex::new(call)))
    }
}

/// Called for its node once an event; see `viewer::event_callback`, which knows the type of events.
#[derive(Clone)]
pub struct EventCallback(Arc<Mutex<OnEvent>>);

impl EventCallback {
    /// A callback that is given events of any type.
    pub fn new(call: impl FnMut(&mut Scene, NodeId, &dyn Any) -> Traverse + Send + 'static) -> Self {
        Self(Arc::new(Mutex::new(call)))
    }
}

impl std::fmt::Debug for UpdateCallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("UpdateCallback")
    }
}

impl std::fmt::Debug for EventCallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("EventCallback")
    }
}

/// A callback that can be called through a shared reference.
trait Call<I: ?Sized>: Clone {
    /// A callback that panicked once is not called again, nor is one from inside itself.
    fn call(&self, scene: &mut Scene, node: NodeId, info: &I) -> Traverse;
    fn of(page: &Page) -> &[(u32, Self)];
}

impl Call<UpdateInfo> for UpdateCallback {
    fn call(&self, scene: &mut Scene, node: NodeId, info: &UpdateInfo) -> Traverse {
        self.0.try_lock().map_or(Traverse::Below, |mut call| call(scene, node, info))
    }

    fn of(page: &Page) -> &[(u32, Self)] {
        &page.update_callbacks
    }
}

impl Call<dyn Any> for EventCallback {
    fn call(&self, scene: &mut Scene, node: NodeId, info: &dyn Any) -> Traverse {
        self.0.try_lock().map_or(Traverse::Below, |mut call| call(scene, node, info))
    }

    fn of(page: &Page) -> &[(u32, Self)] {
        &page.event_callbacks
    }
}

/// Places of the pages that have callbacks, in the order they came: a page after the one it hangs in.
#[derive(Debug, Default)]
pub(super) struct CallbackPages {
    update: Turns,
    event: Turns,
    /// Subtrees left out of the traversal under way: place of the page, first node, end.
    skipped: Vec<(u32, u32, u32)>,
}

/// Pages one after the other, also while some come and go.
#[derive(Debug, Default)]
struct Turns {
    places: Vec<u32>,
    /// Whose turn is next in the traversal under way.
    next: usize,
}

impl Turns {
    fn take(&mut self) -> Option<u32> {
        let place = self.places.get(self.next).copied()?;
        self.next += 1;
        Some(place)
    }

    /// Before the first page that is below it.
    fn insert(&mut self, place: u32, is_below: impl Fn(u32) -> bool) {
        if !self.places.contains(&place) {
            let at = self.places.iter().position(|other| is_below(*other)).unwrap_or(self.places.len());
            self.places.insert(at, place);
            self.next += usize::from(at < self.next);
        }
    }

    fn forget(&mut self, place: u32) {
        if let Some(at) = self.places.iter().position(|other| *other == place) {
            self.places.remove(at);
            self.next -= usize::from(at < self.next);
        }
    }
}

impl CallbackPages {
    /// A page that has come.
    pub fn note(&mut self, place: u32, page: &Page) {
        self.insert(place, page, |_| false);
    }

    fn insert(&mut self, place: u32, page: &Page, is_below: impl Fn(u32) -> bool) {
        if !page.update_callbacks.is_empty() {
            self.update.insert(place, &is_below);
        }
        if !page.event_callbacks.is_empty() {
            self.event.insert(place, &is_below);
        }
    }

    pub fn forget(&mut self, place: u32) {
        self.update.forget(place);
        self.event.forget(place);
    }
}

impl Scene {
    /// Calls the update callbacks of all nodes, in each page depth-first; returns how many nodes it visited. The update
    /// phase, once a frame.
    pub fn update_traversal(&mut self, info: &UpdateInfo) -> usize {
        self.traverse_callbacks::<UpdateInfo, UpdateCallback>(|pages| &mut pages.update, info)
    }

    /// Calls the event callbacks of all nodes, in each page depth-first; returns how many nodes it visited. The event
    /// phase, once an event.
    pub fn event_traversal(&mut self, event: &dyn Any) -> usize {
        self.traverse_callbacks::<dyn Any, EventCallback>(|pages| &mut pages.event, event)
    }

    /// True when some node has an update callback.
    pub fn has_update_callbacks(&self) -> bool {
        self.some_page(&self.callback_pages.update, |page| !page.update_callbacks.is_empty())
    }

    /// True when some node has an event callback.
    pub fn has_event_callbacks(&self) -> bool {
        self.some_page(&self.callback_pages.event, |page| !page.event_callbacks.is_empty())
    }

    /// Pages whose last callback of a kind has gone may be listed for it still.
    fn some_page(&self, turns: &Turns, has: impl Fn(&Page) -> bool) -> bool {
        turns.places.iter().any(|place| self.page(self.page_id_at(*place)).is_some_and(&has))
    }

    /// Gives a node another update callback, or none.
    pub fn set_update_callback(&mut self, node: NodeId, callback: Option<UpdateCallback>) -> Result<(), SceneError> {
        self.set_callback(node, callback, |page| &mut page.update_callbacks)
    }

    /// Gives a node another event callback, or none.
    pub fn set_event_callback(&mut self, node: NodeId, callback: Option<EventCallback>) -> Result<(), SceneError> {
        self.set_callback(node, callback, |page| &mut page.event_callbacks)
    }

    fn set_callback<C>(
        &mut self,
        node: NodeId,
        callback: Option<C>,
        list: fn(&mut Page) -> &mut Vec<(u32, C)>,
    ) -> Result<(), SceneError> {
        let page = self.page_mut(node.page).ok_or(SceneError::StaleNode { node })?;
        if node.index as usize >= page.node_count() {
            return Err(SceneError::StaleNode { node });
        }
        let list = list(page);
        match (list.binary_search_by_key(&node.index, |(index, _)| *index), callback) {
            (Ok(place), Some(callback)) => list[place].1 = callback,
            (Ok(place), None) => drop(list.remove(place)),
            (Err(place), Some(callback)) => list.insert(place, (node.index, callback)),
            (Err(_), None) => {}
        }
        let mut pages = std::mem::take(&mut self.callback_pages);
        match self.page(node.page) {
            // A page between others would lose its turn in the order: forgotten only once both lists are empty.
            Some(page) if page.update_callbacks.is_empty() && page.event_callbacks.is_empty() => {
                pages.forget(node.page.slot);
            }
            Some(page) => pages.insert(node.page.slot, page, |other| self.hangs_in(self.page_id_at(other), node.page)),
            None => {}
        }
        self.callback_pages = pages;
        Ok(())
    }

    fn traverse_callbacks<I: ?Sized, C: Call<I>>(
        &mut self,
        turns: fn(&mut CallbackPages) -> &mut Turns,
        info: &I,
    ) -> usize {
        self.callback_pages.skipped.clear();
        turns(&mut self.callback_pages).next = 0;
        let mut visited = 0;
        // Callbacks may add, remove and change: whatever is next is looked up each time.
        while let Some(place) = turns(&mut self.callback_pages).take() {
            let page_id = self.page_id_at(place);
            let is_skipped = !self.callback_pages.skipped.is_empty() && self.hangs_below_skipped(page_id);
            let mut next_node = if is_skipped { u32::MAX } else { 0 };
            while let Some((node, callback)) = self.page(page_id).and_then(|p| at_or_after(C::of(p), next_node)) {
                visited += 1;
                next_node = node + 1;
                if callback.call(self, NodeId { page: page_id, index: node }, info) == Traverse::Skip
                    && let Some(skip) = self.page(page_id).and_then(|p| p.nodes.get(node as usize)).map(|r| r.skip)
                {
                    next_node = node + skip;
                    self.callback_pages.skipped.push((place, node, next_node));
                }
            }
        }
        visited
    }

    /// True for a page somewhere below another.
    fn hangs_in(&self, page: PageId, above: PageId) -> bool {
        let mut at = self.slot_of(page);
        while let Some(slot) = at {
            if slot.page == above {
                return true;
            }
            at = self.slot_of(slot.page);
        }
        false
    }

    fn hangs_below_skipped(&self, page: PageId) -> bool {
        let mut at = self.slot_of(page);
        while let Some(slot) = at {
            let is_in =
                |&(place, first, end): &(u32, u32, u32)| place == slot.page.slot && (first..end).contains(&slot.index);
            if self.callback_pages.skipped.iter().any(is_in) {
                return true;
            }
            at = self.slot_of(slot.page);
        }
        false
    }
}

fn at_or_after<C: Clone>(list: &[(u32, C)], node: u32) -> Option<(u32, C)> {
    list.get(list.partition_point(|(index, _)| *index < node)).cloned()
}
