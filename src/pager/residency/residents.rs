//! Merged pages in the order of their last use, and what each holds. Update thread.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap};
use std::time::Duration;

use super::budget::MemoryUse;
use super::expiry::Unused;
use crate::pager::frame_times::FrameTimes;
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::{ContentKey, NodeId, PageId, PagingOptions, SlotInfo};

/// The memory of a merged page, and its position in the order of use.
#[derive(Clone, Debug)]
pub(in crate::pager) struct Resident {
    slot: NodeId,
    /// The frame by which it is ordered.
    used_frame: u32,
    /// The number of tiles above it.
    depth: u32,
    cpu_bytes: u64,
    /// By context id.
    gpu_bytes: Box<[(u32, u64)]>,
    paging: PagingOptions,
    /// Keys of the contents that it shares with other pages.
    shared: Box<[ContentKey]>,
}

impl Resident {
    /// Creates the record of a page that was merged into a slot.
    pub fn new(
        slot: NodeId,
        info: &SlotInfo<'_>,
        cpu_bytes: u64,
        gpu_bytes: Vec<(u32, u64)>,
        shared: Box<[ContentKey]>,
    ) -> Self {
        let gpu_bytes = gpu_bytes.into_boxed_slice();
        let (used_frame, depth, paging) = (info.last_used_frame, info.depth, info.paging);
        Self { slot, used_frame, depth, cpu_bytes, gpu_bytes, paging, shared }
    }

    fn bytes(&self) -> MemoryUse {
        MemoryUse { cpu: self.cpu_bytes, gpu: self.gpu_bytes.iter().map(|(_, bytes)| bytes).sum() }
    }

    /// Returns true if the page has not been wanted for as long as the pager and its own options require. The page must
    /// neither have been wanted recently nor be wanted for a coming frame.
    fn is_unused(&self, last_used: u32, unused: Unused, times: &FrameTimes) -> bool {
        let PagingOptions { cannot_expire, min_expiry_frames, min_expiry_s, .. } = self.paging;
        // A time beyond the range of a duration is forever.
        let out_of_range = if min_expiry_s > 0.0 { Duration::MAX } else { Duration::ZERO };
        let own = Duration::try_from_secs_f32(min_expiry_s).unwrap_or(out_of_range);
        let own = Unused::new(min_expiry_frames, own);
        !cannot_expire && unused.allows(last_used, times) && own.allows(last_used, times)
    }
}

/// A page that the application took out of its scene, with the contents that it shared.
pub(in crate::pager) type RemovedByApplication = (PageId, Box<[ContentKey]>);

/// The position of a page in the order of use. Of pages last used in one frame the deepest comes first, because a page
/// cannot leave before those below it.
type Position = (u32, Reverse<u32>, PageId);

/// The merged pages, the least recently used first.
///
/// A use costs nothing here: culls stamp tiles with the number of the frame. A page's position is therefore by the last use
/// that the search has seen, which is never later than the real one. The search looks at the first page. If it was used
/// since, it moves to its real position; otherwise no page was used before it, and it is the least recently used one. If the
/// first page was used too recently to expire, so were all others, and the search ends. The order is that of an exact LRU of
/// frames. It costs O(log n) for each page that leaves, and for each that was used since the search last met it.
///
/// Two kinds of pages have other positions. A page that must stay, since others are attached in it or by its own options,
/// moves to the position of a page used now. A prefetched page has that of the coming frame that wants it; it leaves, the
/// farthest first, only if no page of the past may leave.
pub(super) struct Residents {
    pages: HashMap<PageId, Resident>,
    order: BTreeSet<Position>,
    /// The sum over all pages.
    bytes: MemoryUse,
    removed_by_application: Vec<RemovedByApplication>,
}

impl Residents {
    pub fn new() -> Self {
        Self {
            pages: HashMap::new(),
            order: BTreeSet::new(),
            bytes: MemoryUse::default(),
            removed_by_application: Vec::new(),
        }
    }

    pub fn len(&self) -> usize {
        self.pages.len()
    }

    /// Returns the memory of all pages, without shared contents.
    pub fn bytes(&self) -> MemoryUse {
        self.bytes
    }

    pub fn insert(&mut self, id: PageId, resident: Resident) {
        self.bytes = self.bytes + resident.bytes();
        self.order.insert((resident.used_frame, Reverse(resident.depth), id));
        self.pages.insert(id, resident);
    }

    /// Returns all pages with their slots, in no order.
    pub fn slots(&self) -> impl Iterator<Item = (PageId, NodeId)> {
        self.pages.iter().map(|(id, resident)| (*id, resident.slot))
    }

    /// Removes a page.
    pub fn remove(&mut self, id: PageId) {
        self.pop(id);
    }

    /// Removes and returns all pages for which `condition` holds, the least recently used first.
    pub fn take_if(&mut self, condition: impl Fn(PageId) -> bool) -> Vec<PageId> {
        let taken: Vec<PageId> = self.order.iter().map(|(_, _, id)| *id).filter(|id| condition(*id)).collect();
        taken.iter().for_each(|id| drop(self.pop(*id)));
        taken
    }

    /// Removes the pages for which `is_removed` holds: those that the application took out of their scenes.
    pub fn note_removed(&mut self, is_removed: impl Fn(PageId) -> bool) {
        for id in self.order.iter().map(|(_, _, id)| *id).filter(|id| is_removed(*id)).collect::<Vec<_>>() {
            let shared = self.pop(id).map(|resident| resident.shared);
            self.removed_by_application.extend(shared.map(|shared| (id, shared)));
        }
    }

    /// Returns the pages found since the last call that the application took out of their scenes.
    pub fn take_removed(&mut self) -> Vec<RemovedByApplication> {
        std::mem::take(&mut self.removed_by_application)
    }

    fn pop(&mut self, id: PageId) -> Option<Resident> {
        let resident = self.pages.remove(&id)?;
        self.order.remove(&(resident.used_frame, Reverse(resident.depth), id));
        let bytes = resident.bytes();
        self.bytes.cpu -= bytes.cpu;
        self.bytes.gpu -= bytes.gpu;
        Some(resident)
    }

    /// Moves a page to the position of one that was last used in a frame.
    fn place(&mut self, id: PageId, used_frame: u32) {
        let Some(resident) = self.pages.get_mut(&id) else { return };
        let before = std::mem::replace(&mut resident.used_frame, used_frame);
        self.order.remove(&(before, Reverse(resident.depth), id));
        self.order.insert((used_frame, Reverse(resident.depth), id));
    }

    /// Forgets what pages held in a context that has closed.
    pub fn forget_context(&mut self, context: u32) {
        for resident in self.pages.values_mut() {
            for (_, bytes) in resident.gpu_bytes.iter_mut().filter(|(id, _)| *id == context) {
                self.bytes.gpu -= std::mem::take(bytes);
            }
        }
    }

    /// Returns the page that would leave next by its position, if that position allows it.
    fn first(&self, unused: Unused, times: &FrameTimes) -> Option<(u32, PageId)> {
        let ends = [self.order.first(), self.order.last()].into_iter().flatten();
        ends.map(|(frame, _, id)| (*frame, *id)).find(|(frame, _)| unused.allows(*frame, times))
    }

    /// Removes and returns the least recently used page if it is unused for long enough and can be detached. A page can be
    /// detached if no page is attached in it and no finer page is shown instead of it. Examines at most `looks` pages and
    /// lowers `looks`.
    pub fn pop_expired(
        &mut self,
        scenes: &dyn SceneSet,
        times: &FrameTimes,
        unused: Unused,
        looks: &mut usize,
    ) -> Option<PageId> {
        while *looks > 0 {
            let (placed_at, id) = self.first(unused, times)?;
            *looks -= 1;
            let scene = scenes.numbered(id.scene);
            if scene.is_some_and(|scene| scene.page(id).is_none()) {
                let resident = self.pop(id)?;
                self.removed_by_application.push((id, resident.shared));
                continue;
            }
            let resident = self.pages.get(&id)?;
            let last_used = scene.and_then(|scene| scene.slot(resident.slot)).map_or(0, |slot| slot.last_used_frame);
            let is_coming = placed_at > times.frame();
            if last_used > placed_at || is_coming && last_used != placed_at {
                self.place(id, last_used);
            } else if resident.is_unused(last_used, unused, times) && scene.is_some_and(|scene| scene.is_expirable(id))
            {
                return self.pop(id).map(|_| id);
            } else {
                self.place(id, times.frame());
            }
        }
        None
    }
}
