//! The pages of a scene that have callbacks, in the order in which a traversal visits them. Main thread.
//!
//! A traversal visits only nodes with callbacks. In OSG, counts of children that require traversal serve the same purpose.

use std::ops::Range;

/// The pages with update callbacks, those with event callbacks, and the subtrees that the current traversal leaves out.
#[derive(Debug, Default)]
pub(crate) struct CallbackPages {
    update: PageOrder,
    event: PageOrder,
    skipped: Vec<SkippedSubtree>,
}

/// A subtree that the current traversal leaves out.
#[derive(Clone, Debug)]
struct SkippedSubtree {
    /// The position of the page in the scene's page table.
    page_at: u32,
    nodes: Range<u32>,
}

/// The two kinds of callbacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CallbackKind {
    Update,
    Event,
}

/// Positions of pages in the scene's page table, each behind the page that it is attached to. Pages may be added and removed
/// while a traversal is under way.
#[derive(Debug, Default)]
struct PageOrder {
    pages: Vec<u32>,
    /// The number of pages that the current traversal has visited.
    visited: usize,
}

impl PageOrder {
    /// Adds a page before the first one that is below it.
    fn insert(&mut self, page_at: u32, is_below: impl Fn(u32) -> bool) {
        if !self.pages.contains(&page_at) {
            let at = self.pages.iter().position(|other| is_below(*other)).unwrap_or(self.pages.len());
            self.pages.insert(at, page_at);
            self.visited += usize::from(at < self.visited);
        }
    }

    fn remove(&mut self, page_at: u32) {
        if let Some(at) = self.pages.iter().position(|other| *other == page_at) {
            self.pages.remove(at);
            self.visited -= usize::from(at < self.visited);
        }
    }
}

impl CallbackPages {
    fn order(&mut self, kind: CallbackKind) -> &mut PageOrder {
        match kind {
            CallbackKind::Update => &mut self.update,
            CallbackKind::Event => &mut self.event,
        }
    }

    /// Adds a page that has callbacks of a kind, before the first page for which `is_below` returns true.
    pub fn insert(&mut self, kind: CallbackKind, page_at: u32, is_below: impl Fn(u32) -> bool) {
        self.order(kind).insert(page_at, is_below);
    }

    /// Removes a page that was detached or has no callbacks any more.
    pub fn remove(&mut self, page_at: u32) {
        self.update.remove(page_at);
        self.event.remove(page_at);
    }

    /// Returns the listed pages. A page stays listed when it loses its callbacks of this kind but has others.
    pub fn pages(&self, kind: CallbackKind) -> &[u32] {
        match kind {
            CallbackKind::Update => &self.update.pages,
            CallbackKind::Event => &self.event.pages,
        }
    }

    /// Begins a traversal.
    pub fn start(&mut self, kind: CallbackKind) {
        self.skipped.clear();
        self.order(kind).visited = 0;
    }

    /// Returns the next page of the traversal.
    pub fn next(&mut self, kind: CallbackKind) -> Option<u32> {
        let order = self.order(kind);
        let page = order.pages.get(order.visited).copied()?;
        order.visited += 1;
        Some(page)
    }

    /// Leaves out a subtree for the rest of the traversal.
    pub fn skip(&mut self, page_at: u32, nodes: Range<u32>) {
        self.skipped.push(SkippedSubtree { page_at, nodes });
    }

    /// Returns true if the traversal leaves out subtrees at all.
    pub fn skips_any(&self) -> bool {
        !self.skipped.is_empty()
    }

    /// Returns true if the traversal leaves out a node.
    pub fn is_skipped(&self, page_at: u32, node: u32) -> bool {
        self.skipped.iter().any(|skipped| skipped.page_at == page_at && skipped.nodes.contains(&node))
    }
}
