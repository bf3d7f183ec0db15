//! Merged pages in the order they were last wanted, and what they hold. Main thread.

use std::time::{Duration, Instant};

use lru::LruCache;

use super::scenes::Scenes;
use crate::scene::{ContentKey, NodeId, PageId, PagingOptions};

/// What a merged page holds.
#[derive(Clone, Debug)]
pub(super) struct Resident {
    slot: NodeId,
    cpu_bytes: u64,
    /// By context.
    gpu_bytes: Box<[(u32, u64)]>,
    paging: PagingOptions,
    /// What it shares with others.
    shared: Box<[ContentKey]>,
    /// Frame in which it was last wanted and when that was noticed.
    noticed: Option<(u32, Instant)>,
}

impl Resident {
    pub fn new(
        slot: NodeId,
        cpu_bytes: u64,
        gpu_bytes: Vec<(u32, u64)>,
        paging: PagingOptions,
        shared: Box<[ContentKey]>,
    ) -> Self {
        Self { slot, cpu_bytes, gpu_bytes: gpu_bytes.into_boxed_slice(), paging, shared, noticed: None }
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
        let own_s = self.paging.min_expiry_s;
        // What is more than a duration holds is for ever.
        let beyond = if own_s > 0.0 { Duration::MAX } else { Duration::ZERO };
        let own = Duration::try_from_secs_f32(own_s).unwrap_or(beyond);
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
    /// Pages that somebody else took out of their scenes, with what they shared.
    pub gone: Vec<(PageId, Box<[ContentKey]>)>,
}

impl Residents {
    pub fn new() -> Self {
        Self { pages: LruCache::unbounded(), cpu_bytes: 0, gpu_bytes: 0, gone: Vec::new() }
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
        taken.iter().for_each(|id| drop(self.pop(id)));
        taken
    }

    /// The same for those that are not in a scene any more though the pager did not take them out; see [`Self::gone`].
    pub fn drop_gone(&mut self, is_gone: impl Fn(PageId) -> bool) {
        let gone: Vec<PageId> = self.pages.iter().map(|(id, _)| *id).filter(|id| is_gone(*id)).collect();
        for id in gone {
            let shared = self.pop(&id).map(|resident| resident.shared);
            self.gone.extend(shared.map(|shared| (id, shared)));
        }
    }

    fn pop(&mut self, id: &PageId) -> Option<Resident> {
        let resident = self.pages.pop(id)?;
        self.cpu_bytes -= resident.cpu_bytes;
        self.gpu_bytes -= resident.gpu();
        Some(resident)
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
            if scene.is_some_and(|scene| scene.page(id).is_none()) {
                let resident = self.pop(&id)?;
                self.gone.push((id, resident.shared));
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
