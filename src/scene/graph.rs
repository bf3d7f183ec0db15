//! The scene: a table of pages, and the lists that update and culls need of them.

use std::sync::Arc;

use glam::DAffine3;

use super::callback_pages::{CallbackKind, CallbackPages};
use super::error::SceneError;
use super::features::TileMetadata;
use super::id::{NodeId, PageId, SceneNumber};
use super::nodes::CameraNode;
use super::occluder_pages::OccluderPage;
use super::pages::{DrawSlot, Page, SingleDrawable};
use super::rewritten_mesh::RewrittenMesh;
use crate::math::{BoundingSphere, Ellipsoid, WGS84};
use crate::state::StateSet;

/// An entry of the page table.
#[derive(Debug)]
struct Entry {
    generation: u32,
    page: Option<Box<Page>>,
    /// The slot to which the page is attached; `None` for a root page.
    slot: Option<NodeId>,
    /// The number of tiles above the page's top tiles.
    base_depth: u32,
    /// The index of the page in `Scene::occluder_pages`, if it is listed there.
    occluders_at: u32,
    /// A copy of the page's only drawable, which culls read instead of the page if that is enough.
    single: Option<SingleDrawable>,
    /// True if the page is listed in `Scene::stale_pages`.
    is_stale: bool,
}

impl Entry {
    /// Returns the page to be changed, and drops the copy of its drawable.
    fn page_mut(&mut self) -> Option<&mut Page> {
        self.single = None;
        self.page.as_deref_mut()
    }
}

/// Owns pages. Update holds `&mut Scene`, culls hold `&Scene`.
#[derive(Debug)]
pub struct Scene {
    number: SceneNumber,
    entries: Vec<Entry>,
    /// Positions of unused entries.
    free: Vec<u32>,
    roots: Vec<PageId>,
    page_count: usize,
    /// Increased whenever pages are added, removed or may be changed. It starts at a number that no other scene reaches.
    revision: u64,
    /// The number of records that attach and detach have written so far.
    touched_records: u64,
    callback_pages: CallbackPages,
    /// Pages that have OccluderNodes, in no order.
    occluder_pages: Vec<OccluderPage>,
    fitted_occluders: u64,
    /// Meshes that were changed and not yet sent to the graphics contexts.
    rewritten: Vec<RewrittenMesh>,
    /// Positions of pages whose bounds must be fitted, in no order.
    stale_pages: Vec<u32>,
    /// Slots to be loaded whatever cameras see, which the pager has not taken over yet.
    requested_slots: Vec<NodeId>,
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
            fitted_occluders: 0,
            rewritten: Vec::new(),
            stale_pages: Vec::new(),
            requested_slots: Vec::new(),
        }
    }
}

/// Pages.
impl Scene {
    /// Creates a scene without pages.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the number that distinguishes this scene from all others of the process.
    pub fn number(&self) -> SceneNumber {
        self.number
    }

    /// Adds a page that is attached to no slot, in the world's frame.
    pub fn add_root(&mut self, page: Page) -> PageId {
        let id = self.insert(page, None, 0);
        self.roots.push(id);
        id
    }

    /// Removes a root page; `None` if it is not a root page, or if pages are attached to its slots.
    pub fn remove_root(&mut self, id: PageId) -> Option<Page> {
        let at = self.roots.iter().position(|r| *r == id)?;
        if self.page(id)?.attached_pages() > 0 {
            return None;
        }
        self.roots.remove(at);
        self.take(id)
    }

    /// Returns the root pages in the order in which they were added.
    pub fn roots(&self) -> &[PageId] {
        &self.roots
    }

    /// Returns a page by its handle; `None` if the handle is stale or another scene's.
    pub fn page(&self, id: PageId) -> Option<&Page> {
        let matches = |e: &&Entry| e.generation == id.generation && self.number == id.scene;
        self.entries.get(id.slot as usize).filter(matches)?.page.as_deref()
    }

    /// Returns a page by its handle, to change its draw slots.
    pub fn page_mut(&mut self, id: PageId) -> Option<&mut Page> {
        self.revision += 1;
        let number = self.number;
        let matches = |e: &&mut Entry| e.generation == id.generation && number == id.scene;
        self.entries.get_mut(id.slot as usize).filter(matches)?.page_mut()
    }

    /// Returns the page of a node to be changed, or an error if there is no such node.
    pub(super) fn page_of_node(&mut self, node: NodeId) -> Result<&mut Page, SceneError> {
        let page = self.page_mut(node.page).filter(|page| (node.index as usize) < page.node_count());
        page.ok_or(SceneError::StaleNode { node })
    }

    /// Drops the draw slots of a context that no longer exists from all pages.
    pub(crate) fn forget_context(&mut self, context: u32) {
        for page in self.entries.iter_mut().filter_map(Entry::page_mut) {
            page.forget_context(context);
        }
    }

    /// Takes the draw slots of every page in every context, to be released.
    pub(crate) fn take_draw_slots(&mut self) -> impl Iterator<Item = (u32, Vec<DrawSlot>)> {
        self.revision += 1;
        self.entries.iter_mut().filter_map(Entry::page_mut).flat_map(Page::take_draw_slots)
    }

    /// Returns the slot to which a page is attached; `None` for root pages.
    pub fn slot_of(&self, id: PageId) -> Option<NodeId> {
        self.page(id)?;
        self.slot_at(id.slot)
    }

    /// Returns the sphere around all root pages.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        let spheres = self.roots.iter().filter_map(|r| self.page(*r)).map(Page::bounding_sphere);
        spheres.fold(BoundingSphere::EMPTY, |all, s| all.union(&s))
    }

    /// Returns the ellipsoid of the body that the scene is on: that of the first root that is not on WGS84, else WGS84.
    pub fn ellipsoid(&self) -> Ellipsoid {
        let of_roots = self.roots.iter().filter_map(|root| self.page(*root)).map(Page::ellipsoid);
        of_roots.into_iter().find(|ellipsoid| *ellipsoid != WGS84).unwrap_or(WGS84)
    }

    /// Returns a number that changes whenever pages are added, removed or may have been changed. No other scene returns the
    /// same number.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Returns the number of pages.
    pub fn page_count(&self) -> usize {
        self.page_count
    }

    /// Returns the number of records that attaching and detaching have written so far. Tests use it to check that the cost
    /// depends neither on the page nor on the scene.
    pub fn touched_records(&self) -> u64 {
        self.touched_records
    }

    /// Returns the nodes of a page that have a name, in depth-first order.
    pub fn nodes_named(&self, page: PageId, name: &str) -> impl Iterator<Item = NodeId> {
        let names = self.page(page).map_or(&[][..], Page::names);
        names.iter().filter(move |(n, _)| **n == *name).map(move |(_, index)| NodeId { page, index: *index })
    }

    /// Returns the metadata of a tile or of a content; `None` if it has none, or if it was read without
    /// [`ReadOptions::keep_features`](crate::formats::ReadOptions::keep_features). Ask for each node of an
    /// [`Intersection::node_path`](crate::scene::Intersection::node_path) to learn what the tile set says about a point: the
    /// tileset's metadata is at its root tile, that of a group at the contents.
    pub fn metadata(&self, node: NodeId) -> Option<&TileMetadata> {
        self.page(node.page)?.metadata(node.index)
    }
}

/// Changes of nodes.
impl Scene {
    /// Replaces the map of a Transform node (`parent_from_child`) and fits the bounds of its subtree: 7 ns per node and
    /// drawable. The bounds of the nodes above are fitted by [`Self::compute_bounds`], once for all changes since the last
    /// call.
    pub fn set_transform(&mut self, node: NodeId, parent_from_child: DAffine3) -> Result<(), SceneError> {
        let page = self.page_of_node(node)?;
        if !page.set_transform(node.index, parent_from_child)? {
            return Err(SceneError::NotATransform { node });
        }
        let moves_occluders = page.has_occluders_below(node.index);
        if let Some(occluders) = self.occluders_of(node.page.slot).filter(|_| moves_occluders) {
            occluders.outdate();
        }
        self.note_stale(node.page);
        Ok(())
    }

    /// Returns the values of a camera node; `None` if the node is not a camera, or is stale.
    pub fn camera(&self, node: NodeId) -> Option<&CameraNode> {
        self.page(node.page)?.camera(node.index)
    }

    /// Replaces the values of a camera node: this is how cameras in the graph move, and how their light and air change. The
    /// bounds above it are fitted again if its reference frame changes.
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

    /// Shows or hides a child of a Switch.
    pub fn set_switch(&mut self, node: NodeId, child: usize, shown: bool) -> Result<(), SceneError> {
        let page = self.page_mut(node.page).ok_or(SceneError::StaleNode { node })?;
        let flag = page.switch_mut(node.index).and_then(|s| s.get_mut(child));
        *flag.ok_or(SceneError::NotASwitch { node, child })? = shown;
        Ok(())
    }

    /// Replaces a state set of a page by another wherever the page uses it: this is how state changes while draw may still
    /// read the old set. Returns false if the page does not have the set.
    pub fn replace_state_set(&mut self, page: PageId, old: &Arc<StateSet>, new: Arc<StateSet>) -> bool {
        let sets = self.page_mut(page).into_iter().flat_map(Page::state_sets_mut);
        // A set that replaced others may be listed more than once.
        let same = sets.filter(|set| Arc::ptr_eq(set, old));
        same.map(|set| *set = new.clone()).count() > 0
    }

    /// Returns the mesh changes that were not yet sent to the graphics contexts.
    pub(crate) fn rewritten_mut(&mut self) -> &mut Vec<RewrittenMesh> {
        &mut self.rewritten
    }
}

/// Bounds that must be fitted again.
impl Scene {
    /// Fits the bounds above all changes, children before parents, each node once. Viewers call it in every update;
    /// applications that cull a scene without a viewer call it after their changes. Until then culls take the nodes for
    /// larger than they are, and draw the same; queries return the sphere that will be fitted.
    pub fn compute_bounds(&mut self) {
        while let Some(at) = self.stale_pages.pop() {
            let Some(entry) = self.entries.get_mut(at as usize) else { continue };
            entry.is_stale = false;
            let Some(page) = &mut entry.page else { continue };
            page.compute_bounds();
            let occluders = self.occluder_pages.get_mut(entry.occluders_at as usize);
            if let Some(stale) = occluders.filter(|of| of.place == at && of.is_stale) {
                *stale = OccluderPage::new(at, page);
                self.fitted_occluders += page.occluders().len() as u64;
            }
        }
    }

    /// Lists a changed page whose bounds must be fitted.
    pub(super) fn note_stale(&mut self, page: PageId) {
        let has_moved_occluders = self.occluders_of(page.slot).is_some_and(|of| of.is_stale);
        let Some(entry) = self.entries.get_mut(page.slot as usize) else { return };
        let has_stale = |page: &Page| has_moved_occluders || page.has_stale_bounds();
        if !entry.is_stale && entry.page.as_deref().is_some_and(has_stale) {
            entry.is_stale = true;
            self.stale_pages.push(page.slot);
        }
    }

    /// Returns the number of OccluderNodes around which spheres were fitted because some of their page were moved. Tests
    /// use it to check that many changes in a frame cost only what they touch.
    pub fn fitted_occluders(&self) -> u64 {
        self.fitted_occluders
    }

    /// Returns the pages that have OccluderNodes, in no order.
    pub(crate) fn occluder_pages(&self) -> &[OccluderPage] {
        &self.occluder_pages
    }

    /// Returns the entry of a page among those with OccluderNodes.
    fn occluders_of(&mut self, page_at: u32) -> Option<&mut OccluderPage> {
        let at = self.entries.get(page_at as usize)?.occluders_at as usize;
        self.occluder_pages.get_mut(at).filter(|of| of.place == page_at)
    }
}

/// Lists that update keeps.
impl Scene {
    pub(super) fn callback_pages(&self) -> &CallbackPages {
        &self.callback_pages
    }

    pub(super) fn callback_pages_mut(&mut self) -> &mut CallbackPages {
        &mut self.callback_pages
    }

    /// Counts records that attach or detach has written.
    pub(super) fn count_touched(&mut self, records: u64) {
        self.touched_records += records;
    }

    /// Lists a slot for the pager, to be loaded whatever cameras see.
    pub(super) fn request_slot(&mut self, slot: NodeId) {
        if !self.requested_slots.contains(&slot) {
            self.requested_slots.push(slot);
        }
    }

    /// Takes the slots to be loaded whatever cameras see that were listed since the last call.
    pub(crate) fn take_asked(&mut self) -> Vec<NodeId> {
        std::mem::take(&mut self.requested_slots)
    }

    /// Returns true if [`Self::take_asked`] would return slots.
    pub(crate) fn has_asked(&self) -> bool {
        !self.requested_slots.is_empty()
    }
}

/// The page table. Positions are used where a generation need not be checked.
impl Scene {
    /// Adds a page to the table.
    pub(super) fn insert(&mut self, page: Page, slot: Option<NodeId>, base_depth: u32) -> PageId {
        let at = self.free.last().copied().unwrap_or(self.entries.len() as u32);
        if !page.update_callbacks().is_empty() {
            self.callback_pages.insert(CallbackKind::Update, at, |_| false);
        }
        if !page.event_callbacks().is_empty() {
            self.callback_pages.insert(CallbackKind::Event, at, |_| false);
        }
        self.revision += 1;
        self.page_count += 1;
        let occluders_at = self.occluder_pages.len() as u32;
        if !page.occluders().is_empty() {
            self.occluder_pages.push(OccluderPage::new(at, &page));
        }
        let single = SingleDrawable::of(&page);
        let generation = self.entries.get(at as usize).map_or(0, |entry| entry.generation);
        let id = PageId { scene: self.number, slot: at, generation };
        self.requested_slots.extend(page.tiles().immediate().iter().map(|index| NodeId { page: id, index: *index }));
        let page = Some(Box::new(page));
        match self.free.pop() {
            Some(at) => {
                let entry = &mut self.entries[at as usize];
                (entry.page, entry.slot, entry.base_depth) = (page, slot, base_depth);
                (entry.occluders_at, entry.single) = (occluders_at, single);
            }
            None => {
                let is_stale = false;
                self.entries.push(Entry { generation, page, slot, base_depth, occluders_at, single, is_stale });
            }
        }
        id
    }

    /// Removes a page from the table, its bounds fitted.
    pub(super) fn take(&mut self, id: PageId) -> Option<Page> {
        self.page(id)?;
        let entry = self.entries.get_mut(id.slot as usize)?;
        let mut page = entry.page.take()?;
        page.compute_bounds();
        entry.single = None;
        if !(page.update_callbacks().is_empty() && page.event_callbacks().is_empty()) {
            self.callback_pages.remove(id.slot);
        }
        entry.slot = None;
        entry.generation = entry.generation.wrapping_add(1);
        self.free.push(id.slot);
        self.page_count -= 1;
        self.revision += 1;
        if !page.occluders().is_empty() {
            let at = entry.occluders_at;
            self.occluder_pages.swap_remove(at as usize);
            if let Some(moved) = self.occluder_pages.get(at as usize) {
                self.entries[moved.place as usize].occluders_at = at;
            }
        }
        Some(*page)
    }

    /// Returns the number of tiles above a page's top tiles.
    pub(super) fn base_depth(&self, id: PageId) -> u32 {
        self.entries.get(id.slot as usize).map_or(0, |e| e.base_depth)
    }

    /// Returns the page at a position of the table, whatever its generation.
    pub(crate) fn page_at(&self, at: u32) -> Option<&Page> {
        self.entries.get(at as usize)?.page.as_deref()
    }

    /// Returns the number of positions of the page table, unused ones included.
    pub(super) fn page_table_len(&self) -> u32 {
        self.entries.len() as u32
    }

    /// Returns the only drawable of the page at a position of the table; `None` if the page has others, may have changed,
    /// or is not uploaded to the context.
    pub(crate) fn single_drawable_at(&self, at: u32, context: u32) -> Option<&SingleDrawable> {
        self.entries.get(at as usize)?.single.as_ref().filter(|single| single.context == context)
    }

    /// Returns the page at a position of the table, to be changed.
    pub(super) fn page_at_mut(&mut self, at: u32) -> Option<&mut Page> {
        self.revision += 1;
        self.entries.get_mut(at as usize)?.page_mut()
    }

    /// Returns the slot to which the page at a position of the table is attached.
    pub(crate) fn slot_at(&self, at: u32) -> Option<NodeId> {
        self.entries.get(at as usize)?.slot
    }

    /// Returns the handle of the page at a position of the table.
    pub(crate) fn page_id_at(&self, at: u32) -> PageId {
        let generation = self.entries.get(at as usize).map_or(0, |e| e.generation);
        PageId { scene: self.number, slot: at, generation }
    }
}
