//! Merged pages in the order they were last wanted, and what they hold. Main thread.

use lru::LruCache;

use crate::scene::{NodeId, PageId, Scene};

/// What a merged page holds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Resident {
    pub slot: NodeId,
    pub cpu_bytes: u64,
    pub gpu_bytes: u64,
}

/// Least recently wanted first.
pub(super) struct Residents {
    pages: LruCache<PageId, Resident>,
    pub cpu_bytes: u64,
    pub gpu_bytes: u64,
}

impl Residents {
    pub fn new() -> Self {
        Self { pages: LruCache::unbounded(), cpu_bytes: 0, gpu_bytes: 0 }
    }

    pub fn len(&self) -> usize {
        self.pages.len()
    }

    pub fn insert(&mut self, id: PageId, resident: Resident) {
        self.cpu_bytes += resident.cpu_bytes;
        self.gpu_bytes += resident.gpu_bytes;
        self.pages.put(id, resident);
    }

    /// Forgets all pages that something holds for, oldest first.
    pub fn take_if(&mut self, holds: impl Fn(PageId) -> bool) -> Vec<PageId> {
        let taken: Vec<PageId> = self.pages.iter().rev().map(|(id, _)| *id).filter(|id| holds(*id)).collect();
        for resident in taken.iter().filter_map(|id| self.pages.pop(id)).collect::<Vec<_>>() {
            self.cpu_bytes -= resident.cpu_bytes;
            self.gpu_bytes -= resident.gpu_bytes;
        }
        taken
    }

    /// The page that was not wanted for longest, if it was not wanted for `unused_frames` and can go: nothing hangs
    /// in it and nothing finer is shown instead of it. Pages found in use move to the young end, at most `looks`.
    pub fn pop_expired(
        &mut self,
        scene: &Scene,
        frame: u32,
        unused_frames: u32,
        looks: &mut usize,
    ) -> Option<(PageId, Resident)> {
        while *looks > 0 {
            *looks -= 1;
            let (&id, resident) = self.pages.peek_lru()?;
            let last_used = scene.slot(resident.slot).map_or(0, |s| s.last_used_frame);
            let unused = frame.saturating_sub(last_used) > unused_frames;
            if unused && scene.is_expirable(id) {
                let (id, resident) = self.pages.pop_lru()?;
                self.cpu_bytes -= resident.cpu_bytes;
                self.gpu_bytes -= resident.gpu_bytes;
                return Some((id, resident));
            }
            self.pages.promote(&id);
        }
        None
    }
}
