//! Readiness: whether a tile can be drawn instead of its parent without a hole. Update thread.
//!
//! Attach, detach and failures keep counts of the tiles that are waited for, so that a cull reads one integer per tile to
//! know whether the children can replace it. A change runs up the parents only as far as it matters (at most the depth of
//! the tree, usually one step), never over siblings or other pages.
//!
//! A tile whose load failed is not waited for, as long as one of its siblings is ready: within its volume the content of
//! an ancestor is drawn instead.

use super::tile_record::flag;
use crate::scene::graph::Scene;
use crate::scene::id::{NONE, NodeId};

/// Whether a tile can be drawn instead of its parent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Readiness {
    /// It can, without a hole.
    Ready,
    /// Its load failed. The content of an ancestor can be drawn in its place.
    Unavailable,
    /// It is waited for: its content, or that of tiles below it.
    Missing,
}

/// The readiness of the children of a tile.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChildCounts {
    pub total: u32,
    pub missing: u32,
    pub unavailable: u32,
}

impl ChildCounts {
    /// Returns the number of children that their parent waits for. Unavailable ones count if no child is ready: the parent
    /// is drawn as it is then, and not piece by piece.
    pub fn not_ready(self) -> u32 {
        let none_is_ready = self.missing + self.unavailable >= self.total;
        self.missing + if none_is_ready { self.unavailable } else { 0 }
    }

    /// Returns the readiness of a tile that shows nothing but these children.
    pub fn readiness(self) -> Readiness {
        match self.not_ready() {
            0 => Readiness::Ready,
            _ if self.missing == 0 => Readiness::Unavailable,
            _ => Readiness::Missing,
        }
    }
}

impl Scene {
    /// Notes that the load of a slot failed, or with `failed` false that it may be repeated. A failed slot is not
    /// requested. Until a load succeeds the content of an ancestor is drawn within the tile's volume, and its siblings are
    /// drawn as they become ready. Ignored while a page is in the slot.
    pub fn set_failed(&mut self, slot: NodeId, failed: bool) {
        let set = if failed { flag::FAILED | flag::UNAVAILABLE } else { 0 };
        self.change_failure(slot, set, flag::FAILED & !set);
    }

    /// Forgets the failures of a slot, as if its load had never been tried.
    pub fn forget_failure(&mut self, slot: NodeId) {
        self.change_failure(slot, 0, flag::FAILED | flag::UNAVAILABLE);
    }

    fn change_failure(&mut self, slot: NodeId, set: u16, cleared: u16) {
        let Some(tile) = self.page(slot.page).and_then(|p| p.tile_of(slot.index)) else { return };
        let was = self.readiness(slot.page.slot, tile);
        if let Some(page) = self.page_at_mut(slot.page.slot) {
            let record = page.tiles().records()[tile];
            if !record.has_slot() || record.has(flag::RESIDENT) {
                return;
            }
            page.tiles_mut().set_flags(tile, cleared, false);
            page.tiles_mut().set_flags(tile, set, true);
        }
        self.spread_readiness(slot.page.slot, tile, was);
        if set != 0 {
            self.note_failure_above(slot.page.slot, tile);
        } else if cleared & flag::UNAVAILABLE != 0 {
            self.forget_failure_above(slot.page.slot, tile);
        }
    }

    /// Marks the next content above a failed one: it is loaded even where level skipping would skip it.
    fn note_failure_above(&mut self, page_at: u32, tile: usize) {
        if let Some((page_at, tile)) = self.content_above(page_at, tile)
            && let Some(page) = self.page_at_mut(page_at)
        {
            page.tiles_mut().set_flags(tile, flag::FAILED_BELOW, true);
        }
    }

    /// Unmarks the next content above a tile that is not failed any more, unless another tile below it is. A mark in another
    /// page stays.
    pub(super) fn forget_failure_above(&mut self, page_at: u32, tile: usize) {
        if let Some((above_at, above)) = self.content_above(page_at, tile)
            && above_at == page_at
            && let Some(page) = self.page_at_mut(page_at)
            && !page.tiles().has_unavailable_below(above as u32)
        {
            page.tiles_mut().set_flags(above, flag::FAILED_BELOW, false);
        }
    }

    /// Returns the nearest tile above that has content, across pages.
    fn content_above(&self, mut page_at: u32, mut tile: usize) -> Option<(u32, usize)> {
        loop {
            let parent = self.page_at(page_at)?.tiles().parents()[tile];
            (page_at, tile) = match parent {
                NONE => self.tile_above(page_at)?,
                parent => (page_at, parent as usize),
            };
            let record = self.page_at(page_at)?.tiles().records()[tile];
            if record.has(flag::CONTENT) && !record.has(flag::EXTERNAL) {
                return Some((page_at, tile));
            }
        }
    }

    /// Returns the tile to which a page is attached, with the position of the page that holds the tile; `None` for a root
    /// page.
    pub(crate) fn tile_above(&self, page_at: u32) -> Option<(u32, usize)> {
        let slot = self.slot_at(page_at)?;
        Some((slot.page.slot, self.page(slot.page)?.tile_of(slot.index)?))
    }

    /// Returns whether a tile can be drawn instead of its parent.
    pub(crate) fn readiness(&self, page_at: u32, tile: usize) -> Readiness {
        let Some(page) = self.page_at(page_at) else { return Readiness::Missing };
        let record = &page.tiles().records()[tile];
        if !record.has(flag::RESIDENT) {
            page.tiles().readiness_without_page(tile)
        } else if record.has(flag::EXTERNAL) {
            let external = self.page_at(page.tiles().resident(tile));
            external.map_or(Readiness::Missing, |page| page.tiles().readiness())
        } else {
            Readiness::Ready
        }
    }

    /// Corrects the counts above a tile whose readiness may have changed, across pages.
    pub(super) fn spread_readiness(&mut self, page_at: u32, tile: usize, was: Readiness) {
        let (mut page_at, mut tile, mut was) = (page_at, tile, was);
        loop {
            let is = self.readiness(page_at, tile);
            if is == was {
                return;
            }
            self.count_touched(1);
            let Some(page) = self.page_at(page_at) else { return };
            let parent = page.tiles().parents()[tile];
            let above = if parent == NONE { self.tile_above(page_at) } else { Some((page_at, parent as usize)) };
            let above = above.map(|(page_at, tile)| (page_at, tile, self.readiness(page_at, tile)));
            if let Some(page) = self.page_at_mut(page_at) {
                page.tiles_mut().count_child(parent, was, is);
            }
            let Some(above) = above else { return };
            (page_at, tile, was) = above;
        }
    }

    /// Corrects the counts of busy children above a tile that became resident or was emptied.
    pub(super) fn spread_busy(&mut self, page_at: u32, tile: usize, is_resident: bool) {
        let touched = self.page_at_mut(page_at).map_or(0, |page| page.tiles_mut().spread_busy(tile, is_resident));
        self.count_touched(touched);
    }
}
