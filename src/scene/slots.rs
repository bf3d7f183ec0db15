//! Content slots: the places where pages hang, and the readiness that follows from what hangs there.
//!
//! Update thread. Readiness is kept at attach and detach so that cull asks one integer per tile whether the
//! children can replace it; a change runs up the parents only as far as it matters (at most the tree's depth,
//! usually one step), never over siblings or other pages.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use glam::DAffine3;

use super::graph::Scene;
use super::node::{PagingOptions, ProxyLoading};
use super::page::{NONE, Page};
use super::tiles::flag;
use super::{NodeId, PageId, SceneError};

/// What is in a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotState {
    /// Nothing yet.
    Empty,
    /// A page.
    Resident(PageId),
    /// Loading failed for good; not requested.
    Failed,
}

/// A content slot as the pager sees it.
#[derive(Clone, Copy, Debug)]
pub struct SlotInfo<'a> {
    /// Where the content is read from.
    pub uri: &'a Arc<str>,
    /// What is there.
    pub state: SlotState,
    /// Frame in which a cull last wanted the tile; 0 for never.
    pub last_used_frame: u32,
    /// Tiles above it, over all pages.
    pub depth: u32,
    /// Handed back to the reader.
    pub reader_data: Option<&'a Arc<str>>,
    /// A ProxyNode rather than a PagedLod.
    pub is_proxy: bool,
    /// The page that holds the slot.
    pub page: PageId,
    /// Maps the content to the frame of the page's tiles.
    pub content_transform: DAffine3,
    /// How the pager treats what is there.
    pub paging: PagingOptions,
}

impl Scene {
    /// Looks at a content slot; `None` where the node is gone or has no slot.
    pub fn slot(&self, id: NodeId) -> Option<SlotInfo<'_>> {
        let page = self.page(id.page)?;
        let tile = page.tile_of(id.index)?;
        let record = page.tiles.records.get(tile)?;
        let uri = page.tiles.uris.get(tile)?.as_ref()?;
        let state = if record.has(flag::RESIDENT) {
            SlotState::Resident(PageId {
                scene: id.page.scene,
                slot: page.tiles.contents.get(tile)?.resident,
                generation: page.tiles.resident_generation[tile],
            })
        } else if record.has(flag::FAILED) {
            SlotState::Failed
        } else {
            SlotState::Empty
        };
        Some(SlotInfo {
            uri,
            state,
            last_used_frame: page.tiles.last_used[tile].load(Ordering::Relaxed),
            depth: self.base_depth(id.page) + u32::from(record.depth),
            reader_data: page.tiles.reader_data[tile].as_ref(),
            is_proxy: record.has(flag::PROXY),
            page: id.page,
            content_transform: page.tiles.content_transform(tile),
            paging: page.tiles.paging_of(tile as u32),
        })
    }

    /// Lets the pager load what a [`ProxyNode`](super::ProxyNode) or a PagedLod stands for from its next update on, before
    /// all that cameras want and wherever they look; a ProxyNode that is loaded
    /// [`Never`](super::ProxyLoading::Never) otherwise, say. It expires as others do. Refused where there is no slot, or
    /// something is in it. What failed before is tried once more; what fails in passing goes on being tried, whoever looks.
    pub fn load_proxy(&mut self, node: NodeId) -> Result<(), SceneError> {
        self.free_slot(node)?;
        if !self.asked.contains(&node) {
            self.asked.push(node);
        }
        Ok(())
    }

    /// When what a ProxyNode stands for is loaded; `None` for a PagedLod.
    pub(crate) fn proxy_loading(&self, slot: NodeId) -> Option<ProxyLoading> {
        let page = self.page(slot.page)?;
        let record = page.tiles.records.get(page.tile_of(slot.index)?)?;
        if !record.has(flag::PROXY) {
            None
        } else if record.has(flag::NEVER) {
            Some(ProxyLoading::Never)
        } else if page.tiles.immediate().contains(&slot.index) {
            Some(ProxyLoading::Immediately)
        } else {
            Some(ProxyLoading::DeferToPager)
        }
    }

    /// What is in a slot was wanted in a frame.
    pub(crate) fn note_use(&self, slot: NodeId, frame: u32) {
        let page = self.page(slot.page);
        if let Some(last) = page.and_then(|page| page.tiles.last_used.get(page.tile_of(slot.index)?)) {
            last.store(frame, Ordering::Relaxed);
        }
    }

    /// Slots to be filled whatever cameras see, since the last call.
    pub(crate) fn take_asked(&mut self) -> Vec<NodeId> {
        std::mem::take(&mut self.asked)
    }

    /// There are such.
    pub(crate) fn has_asked(&self) -> bool {
        !self.asked.is_empty()
    }

    /// Every slot of a page (of each PagedLod with content and each ProxyNode), in depth-first order.
    pub fn slots_of_page(&self, id: PageId) -> impl Iterator<Item = NodeId> + '_ {
        self.page(id).into_iter().flat_map(move |page| {
            let nodes = 0..if page.is_tile_tree() { page.node_count() as u32 } else { 0 };
            let has_slot = |node: &u32| page.tile_of(*node).is_some_and(|tile| page.tiles.records[tile].has_slot());
            nodes.filter(has_slot).map(move |index| NodeId { page: id, index })
        })
    }

    /// Marks a slot as failed (not requested; ready only by what replaces it) or as worth another try. Ignored where a
    /// page is.
    pub fn set_failed(&mut self, slot: NodeId, failed: bool) {
        let Some(tile) = self.page(slot.page).and_then(|p| p.tile_of(slot.index)) else { return };
        let was_ready = self.tile_ready(slot.page.slot, tile);
        if let Some(page) = self.page_at_mut(slot.page.slot) {
            let record = &mut page.tiles.records[tile];
            if !record.has_slot() || record.has(flag::RESIDENT) {
                return;
            }
            record.flags = if failed { record.flags | flag::FAILED } else { record.flags & !flag::FAILED };
        }
        self.spread_readiness(slot.page.slot, tile, was_ready);
        if failed {
            self.note_failure_above(slot.page.slot, tile);
        }
    }

    /// The next content above what failed is to be there instead of it, also where it would be skipped.
    fn note_failure_above(&mut self, mut entry: u32, mut tile: usize) {
        loop {
            let parent = self.page_at(entry).map_or(NONE, |page| page.tiles.parents[tile]);
            if parent != NONE {
                tile = parent as usize;
            } else {
                let above = self.slot_at(entry).and_then(|s| Some((s.page.slot, self.page(s.page)?.tile_of(s.index)?)));
                let Some(above) = above else { return };
                (entry, tile) = above;
            }
            let Some(page) = self.page_at_mut(entry) else { return };
            let record = &mut page.tiles.records[tile];
            if record.has(flag::CONTENT) && !record.has(flag::EXTERNAL) {
                record.flags |= flag::FAILED_BELOW;
                return;
            }
        }
    }

    /// Whether a tile can be drawn in its parent's place without a hole.
    pub(super) fn tile_ready(&self, entry: u32, tile: usize) -> bool {
        let Some(page) = self.page_at(entry) else { return false };
        let record = &page.tiles.records[tile];
        if record.has(flag::RESIDENT) {
            !record.has(flag::EXTERNAL) || self.page_at(page.tiles.contents[tile].resident).is_some_and(Page::is_ready)
        } else {
            page.tiles.is_ready_without_page(tile)
        }
    }

    /// After a tile's readiness may have changed: corrects the counts above it, across pages.
    pub(super) fn spread_readiness(&mut self, entry: u32, tile: usize, was_ready: bool) {
        let (mut entry, mut tile, mut was_ready) = (entry, tile, was_ready);
        loop {
            let is_ready = self.tile_ready(entry, tile);
            if is_ready == was_ready {
                return;
            }
            self.touched_records += 1;
            let slot = self.slot_at(entry);
            let Some(page) = self.page_at(entry) else { return };
            let parent = page.tiles.parents[tile];
            if parent != NONE {
                let parent = parent as usize;
                let parent_was_ready = self.tile_ready(entry, parent);
                if let Some(page) = self.page_at_mut(entry) {
                    count(&mut page.tiles.records[parent].not_ready_children, !is_ready);
                }
                (tile, was_ready) = (parent, parent_was_ready);
            } else {
                let above = slot.and_then(|s| Some((s.page.slot, self.page(s.page)?.tile_of(s.index)?)));
                let above = above.map(|(e, t)| (e, t, self.tile_ready(e, t)));
                if let Some(page) = self.page_at_mut(entry) {
                    count(&mut page.tiles.not_ready_roots, !is_ready);
                }
                let Some(above) = above else { return };
                (entry, tile, was_ready) = above;
            }
        }
    }

    /// After a tile became (or ceased to be) resident: corrects who has something resident below.
    pub(super) fn spread_busy(&mut self, entry: u32, tile: usize, now: bool) {
        let Some(page) = self.page_at_mut(entry) else { return };
        let tiles = &mut page.tiles;
        let mut touched = 0;
        // Busy apart from the slot itself: then nothing changes above.
        let mut changes = tiles.busy_children[tile] == 0;
        let mut parent = tiles.parents[tile];
        while changes && parent != NONE {
            let p = parent as usize;
            count(&mut tiles.busy_children[p], now);
            touched += 1;
            changes = tiles.busy_children[p] == u32::from(now) && !tiles.records[p].has(flag::RESIDENT);
            parent = tiles.parents[p];
        }
        self.touched_records += touched;
    }
}

impl Page {
    /// Every top tile is ready.
    pub(crate) fn is_ready(&self) -> bool {
        self.tiles.not_ready_roots == 0
    }
}

fn count(counter: &mut u32, up: bool) {
    if up {
        *counter += 1;
    } else {
        *counter -= 1;
    }
}
