//! Merged pages in the order in which they are examined for expiry, and what each holds.

use std::time::{Duration, Instant};

use lru::LruCache;

use super::budget::MemoryUse;
use super::expiry::Unused;
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::{ContentKey, NodeId, PageId, PagingOptions};

/// The memory of a merged page, and when it was last wanted.
#[derive(Clone, Debug)]
pub(in crate::pager) struct Resident {
    slot: NodeId,
    cpu_bytes: u64,
    /// By context id.
    gpu_bytes: Box<[(u32, u64)]>,
    paging: PagingOptions,
    /// Keys of the contents that it shares with other pages.
    shared: Box<[ContentKey]>,
    /// The frame in which it was last wanted, and when that was first seen by the expiry search.
    noticed: Option<(u32, Instant)>,
}

impl Resident {
    /// Creates the record of a page that was merged into `slot`.
    pub fn new(
        slot: NodeId,
        cpu_bytes: u64,
        gpu_bytes: Vec<(u32, u64)>,
        paging: PagingOptions,
        shared: Box<[ContentKey]>,
    ) -> Self {
        Self { slot, cpu_bytes, gpu_bytes: gpu_bytes.into_boxed_slice(), paging, shared, noticed: None }
    }

    fn bytes(&self) -> MemoryUse {
        MemoryUse { cpu: self.cpu_bytes, gpu: self.gpu_bytes.iter().map(|(_, bytes)| bytes).sum() }
    }

    /// Returns true if the page has not been wanted for as long as the pager and its own options require. The page must
    /// neither have been wanted recently nor be wanted for a coming frame.
    fn is_unused(&mut self, last_used: u32, frame: u32, unused: Unused) -> bool {
        let frames = unused.frames.max(self.paging.min_expiry_frames);
        if self.paging.cannot_expire || frame.abs_diff(last_used) <= frames {
            return false;
        }
        let own_s = self.paging.min_expiry_s;
        // A time beyond the range of a duration is forever.
        let out_of_range = if own_s > 0.0 { Duration::MAX } else { Duration::ZERO };
        let own = Duration::try_from_secs_f32(own_s).unwrap_or(out_of_range);
        let time = unused.time.max(own);
        if time.is_zero() {
            return true;
        }
        match self.noticed {
            Some((noticed, since)) if noticed == last_used => since.elapsed() >= time,
            _ => {
                self.noticed = Some((last_used, Instant::now()));
                false
            }
        }
    }
}

/// A page that the application took out of its scene, with the contents that it shared.
pub(in crate::pager) type RemovedByApplication = (PageId, Box<[ContentKey]>);

/// The merged pages.
///
/// The order is a second-chance (clock) order, not a least recently used one: frames do not move the pages that they use.
/// The search examines the front page; a page found in use moves to the back, an unused one expires.
pub(super) struct Residents {
    pages: LruCache<PageId, Resident>,
    /// The sum over all pages.
    bytes: MemoryUse,
    removed_by_application: Vec<RemovedByApplication>,
}

impl Residents {
    pub fn new() -> Self {
        Self { pages: LruCache::unbounded(), bytes: MemoryUse::default(), removed_by_application: Vec::new() }
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
        self.pages.put(id, resident);
    }

    /// Removes and returns all pages for which `condition` holds, the front of the order first.
    pub fn take_if(&mut self, condition: impl Fn(PageId) -> bool) -> Vec<PageId> {
        let taken: Vec<PageId> = self.pages.iter().rev().map(|(id, _)| *id).filter(|id| condition(*id)).collect();
        taken.iter().for_each(|id| drop(self.pop(id)));
        taken
    }

    /// Removes the pages for which `is_removed` holds: those that the application took out of their scenes.
    pub fn note_removed(&mut self, is_removed: impl Fn(PageId) -> bool) {
        let removed: Vec<PageId> = self.pages.iter().map(|(id, _)| *id).filter(|id| is_removed(*id)).collect();
        for id in removed {
            let shared = self.pop(&id).map(|resident| resident.shared);
            self.removed_by_application.extend(shared.map(|shared| (id, shared)));
        }
    }

    /// Returns the pages found since the last call that the application took out of their scenes.
    pub fn take_removed(&mut self) -> Vec<RemovedByApplication> {
        std::mem::take(&mut self.removed_by_application)
    }

    fn pop(&mut self, id: &PageId) -> Option<Resident> {
        let resident = self.pages.pop(id)?;
        let bytes = resident.bytes();
        self.bytes.cpu -= bytes.cpu;
        self.bytes.gpu -= bytes.gpu;
        Some(resident)
    }

    /// Forgets what pages held in a context that has closed.
    pub fn forget_context(&mut self, context: u32) {
        for (_, resident) in &mut self.pages {
            for (_, bytes) in resident.gpu_bytes.iter_mut().filter(|(id, _)| *id == context) {
                self.bytes.gpu -= std::mem::take(bytes);
            }
        }
    }

    /// Removes and returns the first page that is unused for long enough and can be detached. A page can be detached if no
    /// page is attached in it and no finer page is shown instead of it. Examines at most `looks` pages and lowers `looks`.
    pub fn pop_expired(
        &mut self,
        scenes: &dyn SceneSet,
        frame: u32,
        unused: Unused,
        looks: &mut usize,
    ) -> Option<PageId> {
        while *looks > 0 {
            *looks -= 1;
            let id = *self.pages.peek_lru()?.0;
            let resident = self.pages.peek_mut(&id)?;
            let scene = scenes.numbered(id.scene);
            if scene.is_some_and(|scene| scene.page(id).is_none()) {
                let resident = self.pop(&id)?;
                self.removed_by_application.push((id, resident.shared));
                continue;
            }
            let last_used = scene.and_then(|scene| scene.slot(resident.slot)).map_or(0, |slot| slot.last_used_frame);
            let is_unused = resident.is_unused(last_used, frame, unused);
            if is_unused && scene.is_some_and(|scene| scene.is_expirable(id)) {
                return self.pop(&id).map(|_| id);
            }
            self.pages.promote(&id);
        }
        None
    }
}
