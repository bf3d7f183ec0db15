//! [`Residency`]: the merged pages, their memory and that of the contents they share. Update thread.

use super::budget::{ArrivedTotal, Budget, MemoryUse, Room, moving_mean};
use super::content_users::ContentUsers;
use super::expiry::{ExpirySearch, Unused};
use super::residents::{RemovedByApplication, Resident, Residents};
use crate::pager::frame_times::FrameTimes;
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::{ContentKey, NodeId, Page, PageId, Scene, SceneNumber};

/// The merged pages, what they and arrived pages share, and the sizes of recent pages. Update thread.
pub(in crate::pager) struct Residency {
    /// The budgets of the configuration, without what the trees of roots take.
    budget: Budget,
    roots: RootTrees,
    residents: Residents,
    shared: ContentUsers,
    /// Mean size of recent pages, to reserve budget before a size is known; 0 before the first.
    mean: MemoryUse,
    search: ExpirySearch,
    /// GPU bytes that each context has allocated beyond what is in use, after its last upload.
    unused_gpu: Vec<(u32, u64)>,
}

/// The tile trees that applications added to their scenes: the roots of tile sets.
#[derive(Default)]
struct RootTrees {
    ids: Vec<PageId>,
    /// CPU bytes of all of them.
    bytes: u64,
}

impl Residency {
    pub fn new(budget: Budget) -> Self {
        let (shared, search) = (ContentUsers::default(), ExpirySearch::default());
        let residents = Residents::new();
        Self {
            budget,
            roots: RootTrees::default(),
            residents,
            shared,
            mean: MemoryUse::default(),
            search,
            unused_gpu: Vec::new(),
        }
    }

    /// Takes the trees of the scenes' roots out of the budget of `configured` for CPU memory, but at most half of it: they cannot
    /// expire, and something must be drawn.
    pub fn count_roots(&mut self, scenes: &dyn SceneSet, configured: Budget) {
        let roots = || scenes.all().flat_map(|scene| scene.roots().iter().copied());
        if roots().eq(self.roots.ids.iter().copied()) {
            return;
        }
        let bytes_of = |scene: &Scene| {
            let pages = scene.roots().iter().filter_map(|id| scene.page(*id));
            pages.filter(|page| page.is_tile_tree()).map(Page::own_bytes).sum::<u64>()
        };
        self.roots = RootTrees { ids: roots().collect(), bytes: scenes.all().map(bytes_of).sum() };
        self.budget = configured.without_cpu(self.roots.bytes.min(configured.bytes.cpu / 2));
    }

    /// Returns the CPU bytes of the trees of roots.
    pub fn root_bytes(&self) -> u64 {
        self.roots.bytes
    }

    /// Returns the budgets of pages.
    pub fn budget(&self) -> Budget {
        self.budget
    }

    /// Returns the number of merged pages.
    pub fn len(&self) -> usize {
        self.residents.len()
    }

    /// Returns the memory of merged pages, with shared contents once.
    pub fn merged_bytes(&self) -> MemoryUse {
        self.residents.bytes() + self.shared.merged()
    }

    /// Returns the memory that merged pages save by sharing contents.
    pub fn saved_bytes(&self) -> MemoryUse {
        self.shared.saved()
    }

    /// Returns the memory of merged pages and of all shared contents, without the own memory of arrived pages.
    pub fn bytes_without_arrived(&self) -> MemoryUse {
        self.residents.bytes() + self.shared.all()
    }

    /// Returns the memory of merged and arrived pages, with shared contents once.
    pub fn bytes_in_memory(&self, arrived: &ArrivedTotal) -> MemoryUse {
        self.bytes_without_arrived() + arrived.bytes
    }

    /// Returns true if merged and arrived pages exceed a budget.
    pub fn is_over_budget(&self, arrived: &ArrivedTotal) -> bool {
        self.budget.is_exceeded(self.bytes_in_memory(arrived), self.len() as u64 + arrived.pages)
    }

    /// Returns true if merged and arrived pages exceed a budget together with the GPU memory that is allocated and unused.
    pub fn is_over_budget_allocated(&self, arrived: &ArrivedTotal) -> bool {
        let bytes = self.bytes_in_memory(arrived) + MemoryUse { cpu: 0, gpu: self.unused_gpu() };
        self.budget.is_exceeded(bytes, self.len() as u64 + arrived.pages)
    }

    /// Returns the GPU bytes that contexts have allocated beyond what is in use, after their last uploads.
    pub fn unused_gpu(&self) -> u64 {
        self.unused_gpu.iter().map(|(_, bytes)| bytes).sum()
    }

    /// Notes the GPU bytes that a context has allocated beyond what is in use.
    pub fn note_unused(&mut self, context: u32, bytes: u64) {
        self.unused_gpu.retain(|(id, _)| *id != context);
        self.unused_gpu.push((context, bytes));
    }

    /// Returns the budgets beside what merged and arrived pages take and what is reserved for uploads.
    pub fn room(&self, arrived: &ArrivedTotal) -> Room {
        let reserved = MemoryUse { cpu: 0, gpu: arrived.reserved_gpu };
        let used = self.bytes_in_memory(arrived) + reserved;
        let (pages, unused_gpu) = (self.len() as u64 + arrived.pages, self.unused_gpu());
        Room { budget: self.budget, used, pages, mean: self.mean, unused_gpu }
    }

    /// Returns the mean size of recent pages; 0 before the first.
    pub fn mean_size(&self) -> MemoryUse {
        self.mean
    }

    /// Learns the size of a page that is known now: `own` is its memory without shared contents.
    pub fn learn_size(&mut self, page: &Page, own: MemoryUse) {
        let size = own + self.shared.bytes_only_of(page);
        let cpu = moving_mean(self.mean.cpu, size.cpu);
        self.mean = MemoryUse { cpu, gpu: moving_mean(self.mean.gpu, size.gpu) };
    }

    /// Notes that a page has arrived: it uses its shared contents from now on, and its textures of state sets in all contexts.
    pub fn note_arrival(&mut self, page: &Page, contexts: impl Iterator<Item = u32>) {
        self.shared.add_user(page);
        let textures = page.shared_contents().iter().filter(|used| used.texture_bytes > 0);
        let sizes: Vec<_> = textures.map(|used| (used.content.key, used.texture_bytes)).collect();
        contexts.for_each(|context| self.shared.uploaded(context, &sizes));
    }

    /// Notes that a page is dropped, merged or not.
    pub fn note_drop(&mut self, page: &Page) {
        self.shared.remove_user(page);
    }

    /// Notes the sizes of shared contents that a context has uploaded.
    pub fn note_upload(&mut self, context: u32, shared: &[(ContentKey, u64)]) {
        self.shared.uploaded(context, shared);
    }

    /// Returns the memory of a page's shared contents.
    pub fn shared_bytes(&self, page: &Page) -> MemoryUse {
        self.shared.bytes_of(page)
    }

    /// Returns the memory of the contents that only this page uses.
    pub fn unshared_bytes(&self, page: &Page) -> MemoryUse {
        self.shared.bytes_only_of(page)
    }

    /// Counts the contents of a page as merged, before it is attached.
    pub fn begin_merge(&mut self, page: &Page) {
        self.shared.merge(page);
    }

    /// Undoes [`Self::begin_merge`] for a page that could not be attached.
    pub fn abort_merge(&mut self, page: &Page) {
        self.shared.unmerge(page);
    }

    /// Adds a page that was attached.
    pub fn insert(&mut self, id: PageId, resident: Resident) {
        self.residents.insert(id, resident);
    }

    /// Returns the pages of a scene with their slots, in no order.
    pub fn slots_of(&self, scene: SceneNumber) -> impl Iterator<Item = (PageId, NodeId)> {
        self.residents.slots().filter(move |(page, _)| page.scene == scene)
    }

    /// Removes a page, which the caller detaches with [`Self::detach`].
    pub fn remove(&mut self, id: PageId) {
        self.residents.remove(id);
    }

    /// Returns how many pages this frame may examine for expiry; the maximum when room is short.
    pub fn start_search(&mut self, is_short: bool) -> usize {
        self.search.start(is_short).min(self.len())
    }

    /// Returns how many pages may be examined to make room for an arrival.
    pub fn urgent_looks(&self) -> usize {
        self.len().min(4 * ExpirySearch::max_pages())
    }

    /// Ends the frame's search; `has_found` is true if pages expired.
    pub fn end_search(&mut self, has_found: bool) {
        self.search.end(has_found);
    }

    /// Returns the next page to expire; see [`Residents::pop_expired`]. The caller detaches it with [`Self::detach`].
    pub fn pop_expired(
        &mut self,
        scenes: &dyn SceneSet,
        times: &FrameTimes,
        unused: Unused,
        looks: &mut usize,
    ) -> Option<PageId> {
        self.residents.pop_expired(scenes, times, unused, looks)
    }

    /// Removes all pages of a scene that can be detached now; the caller detaches them with [`Self::detach`].
    pub fn pop_expirable(&mut self, scene: &Scene) -> Vec<PageId> {
        self.residents.take_if(|id| scene.is_expirable(id))
    }

    /// Detaches a removed page from its scene and returns it. Returns `None`, with a log line, if the scene refuses.
    pub fn detach(&mut self, scenes: &mut dyn SceneSet, id: PageId) -> Option<Box<Page>> {
        match scenes.numbered_mut(id.scene)?.detach(id) {
            Ok(page) => {
                self.shared.unmerge(&page);
                Some(Box::new(page))
            }
            Err(e) => {
                log::error!("cannot detach an expired page from its scene: {e}");
                None
            }
        }
    }

    /// Finds the pages of a scene that the application took out of it.
    pub fn find_removed(&mut self, scene: &Scene) {
        let number = scene.number();
        self.residents.note_removed(|id| id.scene == number && scene.page(id).is_none());
    }

    /// Forgets the pages that the application took out of their scenes; returns their ids.
    pub fn forget_removed(&mut self) -> Vec<PageId> {
        let removed: Vec<RemovedByApplication> = self.residents.take_removed();
        removed.iter().for_each(|(_, shared)| self.shared.forget_merged(shared));
        removed.into_iter().map(|(id, _)| id).collect()
    }

    /// Forgets what pages held in a context that has closed.
    pub fn forget_context(&mut self, context: u32) {
        self.residents.forget_context(context);
        self.shared.forget_context(context);
        self.unused_gpu.retain(|(id, _)| *id != context);
    }

    /// Returns the number of frames in which the expiry search examines all pages when room is short.
    pub fn frames_to_search(&self) -> u32 {
        self.len().div_ceil(ExpirySearch::max_pages()) as u32
    }
}
