//! Merged pages in the order they were last wanted, and what they hold. Main thread.

use std::time::{Duration, Instant};

use lru::LruCache;

use super::scenes::Scenes;
use crate::scene::{NodeId, PageId, PagingOptions};

/// What a merged page holds.
#[derive(Clone, Debug)]
pub(super) struct Resident {
    slot: NodeId,
    cpu_bytes: u64,
    /// By context.
    gpu_bytes: Box<[(u32, u64)]>,
    paging: PagingOptions,
    /// Frame in which it was last wanted and when that was noticed.
    noticed: Option<(u32, Instant)>,
}

impl Resident {
    pub fn new(slot: NodeId, cpu_bytes: u64, gpu_bytes: Vec<(u32, u64)>, paging: PagingOptions) -> Self {
        Self { slot, cpu_bytes, gpu_bytes: gpu_bytes.into_boxed_slice(), paging, noticed: None }
    }

    fn gpu(&self) -> u64 {
        self.gpu_bytes.iter().map(|(_, bytes)| bytes).sum()
    }

    /// Not wanted for as long as is asked for, by the pager and by its own options, nor to be wanted before as long.
    fn is_unused(&mut self, last_used: u32, frame: u32, unused: Unused) -> bool {
        let frames = unused.frames.max(self.paging.min_expiry_frames);
        if self.paging.cannot_expire || frame.abs_diff(last_used) <= frames {
            return false;
        }
        let own = Duration::try_from_secs_f32(self.paging.min_expiry_s).unwrap_or_default();
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

/// How long a page must not have been wanted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unused {
    pub frames: u32,
    pub time: Duration,
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
        self.gpu_bytes += resident.gpu();
        self.pages.put(id, resident);
    }

    /// Forgets all pages that something holds for, oldest first.
    pub fn take_if(&mut self, holds: impl Fn(PageId) -> bool) -> Vec<PageId> {
        let taken: Vec<PageId> = self.pages.iter().rev().map(|(id, _)| *id).filter(|id| holds(*id)).collect();
        for resident in taken.iter().filter_map(|id| self.pages.pop(id)).collect::<Vec<_>>() {
            self.cpu_bytes -= resident.cpu_bytes;
            self.gpu_bytes -= resident.gpu();
        }
        taken
    }

    /// What pages hold in a context is gone with it.
    pub fn forget_context(&mut self, context: u32) {
        for (_, resident) in &mut self.pages {
            for (_, bytes) in resident.gpu_bytes.iter_mut().filter(|(of, _)| *of == context) {
                self.gpu_bytes -= std::mem::take(bytes);
            }
        }
    }

    /// The page that was not wanted for longest, if it was not wanted for long enough and can go: nothing hangs in it
    /// and nothing finer is shown instead of it. Pages found in use move to the young end, at most `looks`.
    pub fn pop_expired(
        &mut self,
        scenes: &dyn Scenes,
        frame: u32,
        unused: Unused,
        looks: &mut usize,
    ) -> Option<PageId> {
        while *looks > 0 {
            *looks -= 1;
            let id = *self.pages.peek_lru()?.0;
            let resident = self.pages.peek_mut(&id)?;
            let scene = scenes.numbered(id.scene);
            let last_used = scene.and_then(|scene| scene.slot(resident.slot)).map_or(0, |slot| slot.last_used_frame);
            let is_unused = resident.is_unused(last_used, frame, unused);
            if is_unused && scene.is_some_and(|scene| scene.is_expirable(id)) {
                let resident = self.pages.pop(&id)?;
                self.cpu_bytes -= resident.cpu_bytes;
                self.gpu_bytes -= resident.gpu();
                return Some(id);
            }
            self.pages.promote(&id);
        }
        None
    }
}
