//! Readiness: whether a tile can be drawn instead of its parent without a hole. Update thread.
//!
//! Attach and detach keep counts of the tiles that are not ready, so that a cull reads one integer per tile to know
//! whether the children can replace it. A change runs up the parents only as far as it matters (at most the depth of the
//! tree, usually one step), never over siblings or other pages.

use super::tile_record::flag;
use crate::scene::graph::Scene;
use crate::scene::id::{NONE, NodeId};
use crate::scene::pages::Page;

impl Scene {
    /// Marks a slot as failed or as worth another try. A failed slot is not requested, and the tile is ready only by what
    /// replaces it. Ignored while a page is in the slot.
    pub fn set_failed(&mut self, slot: NodeId, failed: bool) {
        let Some(tile) = self.page(slot.page).and_then(|p| p.tile_of(slot.index)) else { return };
        let was_ready = self.tile_ready(slot.page.slot, tile);
        if let Some(page) = self.page_at_mut(slot.page.slot) {
            let record = page.tiles().records()[tile];
            if !record.has_slot() || record.has(flag::RESIDENT) {
                return;
            }
            page.tiles_mut().set_flags(tile, flag::FAILED, failed);
        }
        self.spread_readiness(slot.page.slot, tile, was_ready);
        if failed {
            self.note_failure_above(slot.page.slot, tile);
        }
    }

    /// Marks the next content above a failed one: it is loaded even where level skipping would skip it.
    fn note_failure_above(&mut self, mut page_at: u32, mut tile: usize) {
        loop {
            let parent = self.page_at(page_at).map_or(NONE, |page| page.tiles().parents()[tile]);
            if parent != NONE {
                tile = parent as usize;
            } else {
                let Some(above) = self.tile_above(page_at) else { return };
                (page_at, tile) = above;
            }
            let Some(page) = self.page_at_mut(page_at) else { return };
            let record = page.tiles().records()[tile];
            if record.has(flag::CONTENT) && !record.has(flag::EXTERNAL) {
                page.tiles_mut().set_flags(tile, flag::FAILED_BELOW, true);
                return;
            }
        }
    }

    /// Returns the tile to which a page is attached, with the position of the page that holds the tile; `None` for a root
    /// page.
    pub(super) fn tile_above(&self, page_at: u32) -> Option<(u32, usize)> {
        let slot = self.slot_at(page_at)?;
        Some((slot.page.slot, self.page(slot.page)?.tile_of(slot.index)?))
    }

    /// Returns true if a tile can be drawn instead of its parent without a hole.
    pub(super) fn tile_ready(&self, page_at: u32, tile: usize) -> bool {
        let Some(page) = self.page_at(page_at) else { return false };
        let record = &page.tiles().records()[tile];
        if record.has(flag::RESIDENT) {
            !record.has(flag::EXTERNAL) || self.page_at(page.tiles().resident(tile)).is_some_and(Page::is_ready)
        } else {
            page.tiles().is_ready_without_page(tile)
        }
    }

    /// Corrects the counts above a tile whose readiness may have changed, across pages.
    pub(super) fn spread_readiness(&mut self, page_at: u32, tile: usize, was_ready: bool) {
        let (mut page_at, mut tile, mut was_ready) = (page_at, tile, was_ready);
        loop {
            let is_ready = self.tile_ready(page_at, tile);
            if is_ready == was_ready {
                return;
            }
            self.count_touched(1);
            let Some(page) = self.page_at(page_at) else { return };
            let parent = page.tiles().parents()[tile];
            let above = if parent == NONE { self.tile_above(page_at) } else { Some((page_at, parent as usize)) };
            let above = above.map(|(page_at, tile)| (page_at, tile, self.tile_ready(page_at, tile)));
            if let Some(page) = self.page_at_mut(page_at) {
                page.tiles_mut().count_ready(parent, is_ready);
            }
            let Some(above) = above else { return };
            (page_at, tile, was_ready) = above;
        }
    }

    /// Corrects the counts of busy children above a tile that became resident or was emptied.
    pub(super) fn spread_busy(&mut self, page_at: u32, tile: usize, is_resident: bool) {
        let touched = self.page_at_mut(page_at).map_or(0, |page| page.tiles_mut().spread_busy(tile, is_resident));
        self.count_touched(touched);
    }
}
