//! Attaching pages to content slots and detaching them. Update thread.
//!
//! Both cost the slot and the readiness above it, whatever the sizes of page and scene.

use super::external_volume::ExternalVolume;
use super::readiness::Readiness;
use crate::scene::error::SceneError;
use crate::scene::graph::Scene;
use crate::scene::id::{NONE, NodeId, PageId};
use crate::scene::pages::Page;

impl Scene {
    /// Attaches a page to a slot: the content of a PagedLod, or what a ProxyNode stands for. A refused page is handed back
    /// with the error.
    pub fn attach(&mut self, slot: NodeId, page: Page) -> Result<PageId, Box<(SceneError, Page)>> {
        let tile = match self.free_slot(slot) {
            Ok(tile) => tile,
            Err(error) => return Err(Box::new((error, page))),
        };
        let holder_at = slot.page.slot;
        let was = self.readiness(holder_at, tile);
        let was_unavailable = was == Readiness::Unavailable;
        let is_tile_tree = page.is_tile_tree();
        let depth = self.page_at(holder_at).map_or(0, |p| u32::from(p.tiles().records()[tile].depth));
        let base_depth = self.base_depth(slot.page) + depth + 1;
        let id = self.insert(page, Some(slot), base_depth);
        if let Some(holder) = self.page_at_mut(holder_at) {
            holder.tiles_mut().set_resident(tile, id, is_tile_tree);
            holder.count_attached();
        }
        self.count_touched(1);
        self.spread_busy(holder_at, tile, true);
        self.spread_readiness(holder_at, tile, was);
        if was_unavailable {
            self.forget_failure_above(holder_at, tile);
        }
        self.note_external_volumes(holder_at, tile);
        Ok(id)
    }

    /// Detaches a page from its slot. Refused while other pages are attached to the page's own slots.
    pub fn detach(&mut self, id: PageId) -> Result<Page, SceneError> {
        let page = self.page(id).ok_or(SceneError::StalePage { page: id })?;
        let slot = self.slot_at(id.slot).ok_or(SceneError::IsRoot { page: id })?;
        if page.attached_pages() > 0 {
            return Err(SceneError::HasPages { page: id, count: page.attached_pages() });
        }
        let holder_at = slot.page.slot;
        if let Some(tile) = self.page_at(holder_at).and_then(|p| p.tile_of(slot.index)) {
            let was = self.readiness(holder_at, tile);
            if let Some(holder) = self.page_at_mut(holder_at) {
                holder.tiles_mut().clear_resident(tile);
                holder.count_detached();
            }
            self.count_touched(1);
            self.spread_busy(holder_at, tile, false);
            self.spread_readiness(holder_at, tile, was);
        }
        self.take(id).ok_or(SceneError::StalePage { page: id })
    }

    /// Returns true if detaching the page leaves no hole: no resident tile refines it, no page is attached to it, and it
    /// is not a root.
    pub fn is_expirable(&self, id: PageId) -> bool {
        let Some(page) = self.page(id) else { return false };
        let Some(slot) = self.slot_at(id.slot) else { return false };
        let Some(holder) = self.page(slot.page) else { return false };
        let Some(tile) = holder.tile_of(slot.index) else { return false };
        page.attached_pages() == 0 && !holder.tiles().is_busy(tile)
    }

    /// Copies the request volumes of the roots of a page that was attached to a tile: to the tile, and to each tile above of
    /// whose page this tile is a root. Usually that is one step.
    fn note_external_volumes(&mut self, mut holder_at: u32, mut tile: usize) {
        loop {
            let Some(holder) = self.page_at(holder_at) else { return };
            let content = self.page_at(holder.tiles().resident(tile));
            let tile_from_content = holder.tiles().content_transform(tile);
            let volumes = content.map_or_else(Vec::new, |page| root_volumes(page, &tile_from_content));
            if volumes.is_empty() && holder.tiles().external_volumes(tile as u32).is_empty() {
                return;
            }
            let parent = holder.tiles().parents()[tile];
            let above = self.tile_above(holder_at);
            self.count_touched(1);
            let Some(holder) = self.page_at_mut(holder_at) else { return };
            if parent != NONE && !volumes.is_empty() {
                holder.tiles_mut().note_volume_below(parent);
            }
            holder.tiles_mut().set_external_volumes(tile as u32, volumes);
            if parent != NONE {
                return;
            }
            let Some(above) = above else { return };
            (holder_at, tile) = above;
        }
    }
}

/// Returns the volumes inside which an eye must be for all tile trees of a page, for the tile whose content the page is.
fn root_volumes(page: &Page, tile_from_page: &glam::DAffine3) -> Vec<ExternalVolume> {
    let mut volumes = Vec::new();
    for root in page.tiles().roots() {
        let root_from_tile = (*tile_from_page * page.transforms().page_from_node(root.transform)).inverse();
        // A tree whose map has no inverse is not drawn.
        if root_from_tile.is_finite() {
            volumes.extend(page.tiles().volumes_of(root.tile).map(|volume| volume.below(&root_from_tile)));
        }
    }
    volumes
}
