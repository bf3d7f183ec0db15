//! Content slots: the tiles to which pages can be attached, as the pager sees them. Update thread.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use glam::DAffine3;

use super::tile_record::flag;
use crate::scene::error::SceneError;
use crate::scene::graph::Scene;
use crate::scene::id::{NodeId, PageId};
use crate::scene::nodes::{PagingOptions, ProxyLoading, ReaderData};

/// The state of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotState {
    /// Nothing is loaded.
    Empty,
    /// A page is attached.
    Resident(PageId),
    /// The last load failed; the slot is not requested until the pager clears this state for a retry.
    Failed,
}

/// A content slot as the pager sees it.
#[derive(Clone, Copy, Debug)]
pub struct SlotInfo<'a> {
    /// The absolute URI of the content.
    pub uri: &'a Arc<str>,
    /// Whether a page is attached, or why not.
    pub state: SlotState,
    /// The frame in which a cull last wanted the tile; 0 for never.
    pub last_used_frame: u32,
    /// The number of tiles above, over all pages.
    pub depth: u32,
    /// Data that is handed back to the reader with the URI.
    pub reader_data: Option<&'a ReaderData>,
    /// True for a ProxyNode, false for a PagedLod.
    pub is_proxy: bool,
    /// The page that holds the slot.
    pub page: PageId,
    /// Maps the content to the frame of the page's tiles.
    pub content_transform: DAffine3,
    /// How the pager treats the content.
    pub paging: PagingOptions,
}

impl Scene {
    /// Returns a content slot; `None` if the node is stale or has no slot.
    pub fn slot(&self, id: NodeId) -> Option<SlotInfo<'_>> {
        let page = self.page(id.page)?;
        let tile = page.tile_of(id.index)?;
        let tiles = page.tiles();
        let record = tiles.records().get(tile)?;
        let uri = tiles.uri(tile)?;
        let state = if record.has(flag::RESIDENT) {
            let (slot, generation) = (tiles.resident(tile), tiles.generation(tile));
            SlotState::Resident(PageId { scene: id.page.scene, slot, generation })
        } else if record.has(flag::FAILED) {
            SlotState::Failed
        } else {
            SlotState::Empty
        };
        Some(SlotInfo {
            uri,
            state,
            last_used_frame: tiles.last_used()[tile].load(Ordering::Relaxed),
            depth: self.base_depth(id.page) + u32::from(record.depth),
            reader_data: tiles.reader_data(tile),
            is_proxy: record.has(flag::PROXY),
            page: id.page,
            content_transform: tiles.content_transform(tile),
            paging: tiles.paging_of(tile as u32),
        })
    }

    /// Returns the tile of an empty slot, or why a page cannot be attached.
    pub(super) fn free_slot(&self, slot: NodeId) -> Result<usize, SceneError> {
        let page = self.page(slot.page).ok_or(SceneError::StaleNode { node: slot })?;
        let tile = page.tile_of(slot.index).ok_or(SceneError::NotASlot { node: slot })?;
        let record = &page.tiles().records()[tile];
        if !record.has_slot() {
            Err(SceneError::NotASlot { node: slot })
        } else if record.has(flag::RESIDENT) {
            Err(SceneError::SlotTaken { node: slot })
        } else {
            Ok(tile)
        }
    }

    /// Asks the pager to load the content of a [`ProxyNode`](super::super::ProxyNode) or PagedLod at its next update, ahead
    /// of everything that cameras want and wherever they look. This is how a ProxyNode with
    /// [`Never`](super::super::ProxyLoading::Never) is loaded. The page expires like others. Fails if there is no slot, or
    /// a page is in it. A load that failed before is tried once more; transient failures are retried, whatever cameras see.
    pub fn load_proxy(&mut self, node: NodeId) -> Result<(), SceneError> {
        self.free_slot(node)?;
        self.request_slot(node);
        Ok(())
    }

    /// Returns when the content of a ProxyNode is loaded; `None` for a PagedLod.
    pub(crate) fn proxy_loading(&self, slot: NodeId) -> Option<ProxyLoading> {
        let page = self.page(slot.page)?;
        let record = page.tiles().records().get(page.tile_of(slot.index)?)?;
        if !record.has(flag::PROXY) {
            None
        } else if record.has(flag::NEVER) {
            Some(ProxyLoading::Never)
        } else if page.tiles().immediate().contains(&slot.index) {
            Some(ProxyLoading::Immediately)
        } else {
            Some(ProxyLoading::DeferToPager)
        }
    }

    /// Stores the frame in which the content of a slot was wanted.
    pub(crate) fn note_use(&self, slot: NodeId, frame: u32) {
        if let Some((page, tile)) = self.page(slot.page).and_then(|page| Some((page, page.tile_of(slot.index)?))) {
            page.tiles().note_use(tile, frame);
        }
    }

    /// Returns every slot of a page (of each PagedLod with content and each ProxyNode), in depth-first order.
    pub fn slots_of_page(&self, id: PageId) -> impl Iterator<Item = NodeId> + '_ {
        self.page(id).into_iter().flat_map(move |page| {
            let nodes = 0..if page.is_tile_tree() { page.node_count() as u32 } else { 0 };
            let has_slot = |node: &u32| page.tile_of(*node).is_some_and(|tile| page.tiles().records()[tile].has_slot());
            nodes.filter(has_slot).map(move |index| NodeId { page: id, index })
        })
    }
}
