//! The scene: a table of pages.

use std::sync::Arc;

use glam::DAffine3;

use super::callbacks::CallbackPages;
use super::error::SceneError;
use super::kinds::CameraNode;
use super::lone::LoneDrawable;
use super::occluders::OccluderPage;
use super::page::{DrawSlot, NONE, Page};
use super::tiles::flag;
use super::variance::Rewritten;
use super::{NodeId, PageId, SceneNumber};
use crate::math::BoundingSphere;
use crate::state::StateSet;

/// A place in the page table.
#[derive(Debug)]
struct Entry {
    generation: u32,
    page: Option<Box<Page>>,
    /// Where the page hangs; `None` for a root page.
    slot: Option<NodeId>,
    /// Tiles above the page's top tiles.
    base_depth: u32,
    /// Its place in `Scene::occluder_pages`, where it is there.
    occluders_at: u32,
    /// What culls read instead of the page, where that is enough.
    lone: Option<LoneDrawable>,
    /// It is in `Scene::stale_pages`.
    is_stale: bool,
}

impl Entry {
    /// The page, to be changed.
    fn page_mut(&mut self) -> Option<&mut Page> {
        self.lone = None;
        self.page.as_deref_mut()
    }
}

/// Owns pages. Update holds `&mut Scene`, cull `&Scene`.
#[derive(Debug)]
pub struct Scene {
    number: SceneNumber,
    entries: Vec<Entry>,
    free: Vec<u32>,
    roots: Vec<PageId>,
    page_count: usize,
    /// Changed whenever pages come, go or may be changed; counted from a number on that no other scene comes to.
    revision: u64,
    /// Records that attach and detach have written so far.
    pub(super) touched_records: u64,
    pub(super) callback_pages: CallbackPages,
    /// Pages that have OccluderNodes, in no order.
    occluder_pages: Vec<OccluderPage>,
    /// Meshes that were changed and have not been sent to be drawn.
    pub(super) rewritten: Vec<Rewritten>,
    /// Places of pages that have bounds to be fitted, in no order.
    stale_pages: Vec<u32>,
    /// Slots to be filled whatever cameras see, which the pager has not taken up.
    pub(super) asked: Vec<NodeId>,
}

impl Default for Scene {
    fn default() -> Self {
        let number = SceneNumber::next();
        Self {
            number,
            entries: Vec::new(),
            free: Vec::new(),
            roots: Vec::new(),
            page_count: 0,
            revision: u64::from(number.get()) << 40,
            touched_records: 0,
            callback_pages: CallbackPages::default(),
            occluder_pages: Vec::new(),
            rewritten: Vec::new(),
            stale_pages: Vec::new(),
            asked: Vec::new(),
        }
    }
}

impl Scene {
    /// A scene without pages.
    pub fn new() -> Self {
        Self::default()
    }

    /// What tells it from other scenes.
    pub fn number(&self) -> SceneNumber {
        self.number
    }

    /// Adds a page that hangs in no slot, in the world's frame.
    pub fn add_root(&mut self, page: Page) -> PageId {
        let id = self.insert(page, None, 0);
        self.roots.push(id);
        id
    }

    /// Takes a root page out; `None` when it is not one, or while pages hang in its slots.
    pub fn remove_root(&mut self, id: PageId) -> Option<Page> {
        let place = self.roots.iter().position(|r| *r == id)?;
        if self.page(id)?.attached_pages > 0 {
            return None;
        }
        self.roots.remove(place);
        self.take(id)
    }

    /// The root pages in the order they were added.
    pub fn roots(&self) -> &[PageId] {
        &self.roots
    }

    /// Hangs a page into a slot: content of a PagedLod or what a ProxyNode stands for. Touches the slot and the
    /// readiness above it, whatever the sizes of page and scene. A refused page is handed back.
    pub fn attach(&mut self, slot: NodeId, page: Page) -> Result<PageId, Box<(SceneError, Page)>> {
        let tile = match self.free_slot(slot) {
            Ok(tile) => tile,
            Err(error) => return Err(Box::new((error, page))),
        };
        let entry = slot.page.slot;
        let was_ready = self.tile_ready(entry, tile);
        let mut flags = flag::RESIDENT;
        if page.is_tile_tree() {
            flags |= flag::EXTERNAL;
        }
        let depth = self.page_at(entry).map_or(0, |p| u32::from(p.tiles.records[tile].depth));
        let base_depth = self.base_depth(slot.page) + depth + 1;
        let id = self.insert(page, Some(slot), base_depth);
        if let Some(holder) = self.page_at_mut(entry) {
            let record = &mut holder.tiles.records[tile];
            record.flags = (record.flags & !flag::FAILED) | flags;
            holder.tiles.contents[tile].resident = id.slot;
            holder.tiles.resident_generation[tile] = id.generation;
            holder.attached_pages += 1;
        }
        self.touched_records += 1;
        self.spread_busy(entry, tile, true);
        self.spread_readiness(entry, tile, was_ready);
        self.note_external_volumes(entry, tile);
        Ok(id)
    }

    /// Takes a page out of its slot; refused while other pages hang in its own slots. Costs what attach costs.
    pub fn detach(&mut self, id: PageId) -> Result<Page, SceneError> {
        let page = self.page(id).ok_or(SceneError::StalePage { page: id })?;
        let slot = self.slot_at(id.slot).ok_or(SceneError::IsRoot { page: id })?;
        if page.attached_pages > 0 {
            return Err(SceneError::HasPages { page: id, count: page.attached_pages });
        }
        let entry = slot.page.slot;
        if let Some(tile) = self.page_at(entry).and_then(|p| p.tile_of(slot.index)) {
            let was_ready = self.tile_ready(entry, tile);
            if let Some(holder) = self.page_at_mut(entry) {
                let record = &mut holder.tiles.records[tile];
                record.flags &= !(flag::RESIDENT | flag::EXTERNAL);
                holder.tiles.contents[tile].resident = NONE;
                holder.attached_pages -= 1;
            }
            self.touched_records += 1;
            self.spread_busy(entry, tile, false);
            self.spread_readiness(entry, tile, was_ready);
        }
        self.take(id).ok_or(SceneError::StalePage { page: id })
    }

    /// True when taking the page out leaves no hole: no resident tile refines it, nothing hangs in it, not a root.
    pub fn is_expirable(&self, id: PageId) -> bool {
        let Some(page) = self.page(id) else { return false };
        let Some(slot) = self.slot_at(id.slot) else { return false };
        let Some(holder) = self.page(slot.page) else { return false };
        let Some(tile) = holder.tile_of(slot.index) else { return false };
        page.attached_pages == 0 && holder.tiles.busy_children[tile] == 0
    }

    /// A page by its handle; `None` where it is stale, or another scene's.
    pub fn page(&self, id: PageId) -> Option<&Page> {
        let is_it = |e: &&Entry| e.generation == id.generation && self.number == id.scene;
        self.entries.get(id.slot as usize).filter(is_it)?.page.as_deref()
    }

    /// A page to change its draw slots.
    pub fn page_mut(&mut self, id: PageId) -> Option<&mut Page> {
        self.revision += 1;
        let number = self.number;
        let is_it = |e: &&mut Entry| e.generation == id.generation && number == id.scene;
        self.entries.get_mut(id.slot as usize).filter(is_it)?.page_mut()
    }

    /// Forgets where a context kept the pages' drawables.
    pub(crate) fn forget_context(&mut self, context: u32) {
        for page in self.entries.iter_mut().filter_map(Entry::page_mut) {
            page.draw_slots.retain(|(of, _)| *of != context);
        }
    }

    /// Takes the slots of every page in every context, to be released.
    pub(crate) fn take_draw_slots(&mut self) -> impl Iterator<Item = (u32, Vec<DrawSlot>)> {
        self.revision += 1;
        self.entries.iter_mut().filter_map(Entry::page_mut).flat_map(Page::take_draw_slots)
    }

    /// The slot in which a page hangs; `None` for root pages.
    pub fn slot_of(&self, id: PageId) -> Option<NodeId> {
        self.page(id)?;
        self.slot_at(id.slot)
    }

    /// The sphere around all root pages.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        let spheres = self.roots.iter().filter_map(|r| self.page(*r)).map(Page::bounding_sphere);
        spheres.fold(BoundingSphere::EMPTY, |all, s| all.union(&s))
    }

    /// Another number whenever pages came, went or may have been changed; never that of another scene.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// How many pages there are.
    pub fn page_count(&self) -> usize {
        self.page_count
    }

    /// Records that attaching and detaching have written so far: the measure that their cost depends neither on
    /// the page nor on the scene.
    pub fn touched_records(&self) -> u64 {
        self.touched_records
    }

    /// Replaces the map of a Transform node (`parent_from_child`) and fits the bounds of its subtree again: 7 ns per node
    /// and drawable below it. Those of its ancestors in the page are fitted by [`Self::compute_bounds`], once for all
    /// changes since the last time.
    pub fn set_transform(&mut self, node: NodeId, parent_from_child: DAffine3) -> Result<(), SceneError> {
        let page = self.page_mut(node.page).ok_or(SceneError::StaleNode { node })?;
        if node.index as usize >= page.node_count() {
            return Err(SceneError::StaleNode { node });
        }
        if !page.set_transform(node.index, parent_from_child)? {
            return Err(SceneError::NotATransform { node });
        }
        if !page.occluders.is_empty() {
            let moved = OccluderPage::new(node.page.slot, page);
            self.occluder_pages[self.entries[node.page.slot as usize].occluders_at as usize] = moved;
        }
        self.note_stale(node.page);
        Ok(())
    }

    /// Fits the bounds above what has changed, children before parents, each once. Viewers call it in every update;
    /// whoever culls a scene without a viewer calls it once changes are made. Until then a cull takes these nodes for
    /// larger than they are, and draws the same all the same; whoever asks for a sphere is told the one that it will be.
    pub fn compute_bounds(&mut self) {
        while let Some(place) = self.stale_pages.pop() {
            let Some(entry) = self.entries.get_mut(place as usize) else { continue };
            entry.is_stale = false;
            if let Some(page) = &mut entry.page {
                page.compute_bounds();
            }
        }
    }

    /// A page was changed: what is above the change is fitted later.
    pub(super) fn note_stale(&mut self, page: PageId) {
        let Some(entry) = self.entries.get_mut(page.slot as usize) else { return };
        if !entry.is_stale && entry.page.as_ref().is_some_and(|page| !page.stale.is_empty()) {
            entry.is_stale = true;
            self.stale_pages.push(page.slot);
        }
    }

    /// What a camera node holds; `None` where the node is none, or not there any more.
    pub fn camera(&self, node: NodeId) -> Option<&CameraNode> {
        self.page(node.page)?.camera(node.index)
    }

    /// Puts other values into a camera node: how cameras in the graph move, and how their light and air change. Bounds
    /// above it are fitted again where its reference frame is another one.
    pub fn set_camera(&mut self, node: NodeId, camera: CameraNode) -> Result<(), SceneError> {
        let page = self.page_mut(node.page).ok_or(SceneError::StaleNode { node })?;
        if !(camera.view.is_finite() && camera.projection.is_none_or(|p| p.is_finite())) {
            return Err(SceneError::NotFinite);
        }
        if !page.set_camera(node.index, camera) {
            return Err(SceneError::NotACamera { node });
        }
        self.note_stale(node.page);
        Ok(())
    }

    /// The nodes of a page that have a name, in depth-first order.
    pub fn nodes_named(&self, page: PageId, name: &str) -> impl Iterator<Item = NodeId> {
        let names = self.page(page).map_or(&[][..], |p| &p.names);
        names.iter().filter(move |(n, _)| **n == *name).map(move |(_, index)| NodeId { page, index: *index })
    }

    /// Shows or hides a child of a Switch.
    pub fn set_switch(&mut self, node: NodeId, child: usize, shown: bool) -> Result<(), SceneError> {
        let page = self.page_mut(node.page).ok_or(SceneError::StaleNode { node })?;
        let flag = page.switch_mut(node.index).and_then(|s| s.get_mut(child));
        *flag.ok_or(SceneError::NotASwitch { node, child })? = shown;
        Ok(())
    }

    /// Puts another state set in the place of one of a page's, wherever in the page it hangs: how state changes
    /// while it may still be drawn. False when the page has no such set.
    pub fn replace_state_set(&mut self, page: PageId, old: &Arc<StateSet>, new: Arc<StateSet>) -> bool {
        let sets = self.page_mut(page).into_iter().flat_map(|page| &mut page.state_sets);
        // One that took another's place may stand there twice.
        let places = sets.filter(|set| Arc::ptr_eq(set, old));
        places.map(|set| *set = new.clone()).count() > 0
    }

    pub(super) fn free_slot(&self, slot: NodeId) -> Result<usize, SceneError> {
        let page = self.page(slot.page).ok_or(SceneError::StaleNode { node: slot })?;
        let tile = page.tile_of(slot.index).ok_or(SceneError::NotASlot { node: slot })?;
        let record = &page.tiles.records[tile];
        if !record.has_slot() {
            Err(SceneError::NotASlot { node: slot })
        } else if record.has(flag::RESIDENT) {
            Err(SceneError::SlotTaken { node: slot })
        } else {
            Ok(tile)
        }
    }

    fn insert(&mut self, page: Page, slot: Option<NodeId>, base_depth: u32) -> PageId {
        let place = self.free.last().copied().unwrap_or(self.entries.len() as u32);
        self.callback_pages.note(place, &page);
        self.revision += 1;
        self.page_count += 1;
        let occluders_at = self.occluder_pages.len() as u32;
        if !page.occluders.is_empty() {
            self.occluder_pages.push(OccluderPage::new(place, &page));
        }
        let lone = LoneDrawable::of(&page);
        let generation = self.entries.get(place as usize).map_or(0, |entry| entry.generation);
        let id = PageId { scene: self.number, slot: place, generation };
        self.asked.extend(page.tiles.immediate().iter().map(|index| NodeId { page: id, index: *index }));
        let page = Some(Box::new(page));
        match self.free.pop() {
            Some(place) => {
                let entry = &mut self.entries[place as usize];
                (entry.page, entry.slot, entry.base_depth) = (page, slot, base_depth);
                (entry.occluders_at, entry.lone) = (occluders_at, lone);
            }
            None => {
                let is_stale = false;
                self.entries.push(Entry { generation, page, slot, base_depth, occluders_at, lone, is_stale });
            }
        }
        id
    }

    fn take(&mut self, id: PageId) -> Option<Page> {
        self.page(id)?;
        let entry = self.entries.get_mut(id.slot as usize)?;
        let mut page = entry.page.take()?;
        page.compute_bounds();
        entry.lone = None;
        if !(page.update_callbacks.is_empty() && page.event_callbacks.is_empty()) {
            self.callback_pages.forget(id.slot);
        }
        entry.slot = None;
        entry.generation = entry.generation.wrapping_add(1);
        self.free.push(id.slot);
        self.page_count -= 1;
        self.revision += 1;
        if !page.occluders.is_empty() {
            let at = entry.occluders_at;
            self.occluder_pages.swap_remove(at as usize);
            if let Some(moved) = self.occluder_pages.get(at as usize) {
                self.entries[moved.place as usize].occluders_at = at;
            }
        }
        Some(*page)
    }

    /// The pages that have OccluderNodes.
    pub(crate) fn occluder_pages(&self) -> &[OccluderPage] {
        &self.occluder_pages
    }

    pub(super) fn base_depth(&self, id: PageId) -> u32 {
        self.entries.get(id.slot as usize).map_or(0, |e| e.base_depth)
    }

    /// The page in a place of the table, whatever its generation.
    pub(crate) fn page_at(&self, place: u32) -> Option<&Page> {
        self.entries.get(place as usize)?.page.as_deref()
    }

    /// The page in a place of the table, where it is one drawable and was compiled for a context.
    pub(crate) fn lone_at(&self, place: u32, context: u32) -> Option<&LoneDrawable> {
        self.entries.get(place as usize)?.lone.as_ref().filter(|lone| lone.context == context)
    }

    pub(super) fn page_at_mut(&mut self, place: u32) -> Option<&mut Page> {
        self.revision += 1;
        self.entries.get_mut(place as usize)?.page_mut()
    }

    pub(crate) fn slot_at(&self, place: u32) -> Option<NodeId> {
        self.entries.get(place as usize)?.slot
    }

    /// The handle of the page in a place of the table.
    pub(crate) fn page_id_at(&self, place: u32) -> PageId {
        let generation = self.entries.get(place as usize).map_or(0, |e| e.generation);
        PageId { scene: self.number, slot: place, generation }
    }
}
