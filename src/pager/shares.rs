//! What pages share and what it costs, each content once, however many pages use it. Main thread.

use std::collections::HashMap;

use crate::scene::{ContentKey, Page};

/// One shared content.
#[derive(Debug, Default)]
struct Share {
    /// Pages that use it, those on their way included.
    users: u32,
    /// Those of them that are merged, or about to be.
    merged: u32,
    cpu_bytes: u64,
    /// By context.
    gpu_bytes: Vec<(u32, u64)>,
}

impl Share {
    fn gpu(&self) -> u64 {
        self.gpu_bytes.iter().map(|(_, bytes)| bytes).sum()
    }
}

/// Bytes on both sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Held {
    pub cpu: u64,
    pub gpu: u64,
}

/// Shared contents by key; only looked up, walked when a context closes.
#[derive(Debug, Default)]
pub(super) struct Shares {
    by_key: HashMap<ContentKey, Share>,
    /// Of contents that merged pages use.
    pub held: Held,
    /// Of contents that any page uses, those on their way included.
    pub all: Held,
    /// What merged pages would hold besides, each with a copy of its own.
    pub saved: Held,
}

impl Shares {
    /// A page is on its way to the contexts.
    pub fn take(&mut self, page: &Page) {
        for used in page.shared_contents() {
            let share = self.by_key.entry(used.content.key).or_default();
            share.users += 1;
            let more = used.tree_bytes.saturating_sub(share.cpu_bytes);
            share.cpu_bytes += more;
            self.all.cpu += more;
            if let Some(others) = share.merged.checked_sub(1) {
                self.held.cpu += more;
                self.saved.cpu += u64::from(others) * more;
            }
        }
    }

    /// A context has the contents.
    pub fn uploaded(&mut self, context: u32, shared: &[(ContentKey, u64)]) {
        for (key, bytes) in shared {
            let Some(share) = self.by_key.get_mut(key) else { continue };
            let before = share.gpu();
            match share.gpu_bytes.iter_mut().find(|(of, _)| *of == context) {
                Some((_, known)) => *known = *bytes,
                None => share.gpu_bytes.push((context, *bytes)),
            }
            self.all.gpu = self.all.gpu + share.gpu() - before;
            if let Some(others) = share.merged.checked_sub(1) {
                let after = share.gpu();
                self.held.gpu = self.held.gpu + after - before;
                self.saved.gpu = self.saved.gpu + u64::from(others) * after - u64::from(others) * before;
            }
        }
    }

    /// A context is gone, and all that was in it.
    pub fn forget_context(&mut self, context: u32) {
        for share in self.by_key.values_mut() {
            let Some(place) = share.gpu_bytes.iter().position(|(of, _)| *of == context) else { continue };
            let (_, bytes) = share.gpu_bytes.swap_remove(place);
            self.all.gpu -= bytes;
            if let Some(others) = share.merged.checked_sub(1) {
                self.held.gpu -= bytes;
                self.saved.gpu -= u64::from(others) * bytes;
            }
        }
    }

    /// All bytes of a page's shared contents.
    pub fn of(&self, page: &Page) -> Held {
        let mut held = Held::default();
        for share in page.shared_contents().iter().filter_map(|used| self.by_key.get(&used.content.key)) {
            held.cpu += share.cpu_bytes;
            held.gpu += share.gpu();
        }
        held
    }

    /// Bytes of contents that a page alone uses.
    pub fn only_of(&self, page: &Page) -> Held {
        let mut held = Held::default();
        let shares = page.shared_contents().iter().filter_map(|used| self.by_key.get(&used.content.key));
        for share in shares.filter(|share| share.users == 1) {
            held.cpu += share.cpu_bytes;
            held.gpu += share.gpu();
        }
        held
    }

    /// A page is merged, or is about to be: what nobody had counts from now on.
    pub fn merge(&mut self, page: &Page) {
        for used in page.shared_contents() {
            let Some(share) = self.by_key.get_mut(&used.content.key) else { continue };
            share.merged += 1;
            let sum = if share.merged == 1 { &mut self.held } else { &mut self.saved };
            sum.cpu += share.cpu_bytes;
            sum.gpu += share.gpu();
        }
    }

    /// The opposite of [`Self::merge`].
    pub fn unmerge(&mut self, page: &Page) {
        self.unmerge_all(keys(page));
    }

    /// A merged page is gone that shared these.
    pub fn forget(&mut self, shared: &[ContentKey]) {
        self.unmerge_all(shared.iter());
        self.give_back_all(shared.iter());
    }

    fn unmerge_all<'a>(&mut self, keys: impl Iterator<Item = &'a ContentKey>) {
        for key in keys {
            let Some(share) = self.by_key.get_mut(key) else { continue };
            share.merged = share.merged.saturating_sub(1);
            let sum = if share.merged == 0 { &mut self.held } else { &mut self.saved };
            sum.cpu = sum.cpu.saturating_sub(share.cpu_bytes);
            sum.gpu = sum.gpu.saturating_sub(share.gpu());
        }
    }

    /// The opposite of [`Self::take`]: the page's places are given back.
    pub fn give_back(&mut self, page: &Page) {
        self.give_back_all(keys(page));
    }

    fn give_back_all<'a>(&mut self, keys: impl Iterator<Item = &'a ContentKey>) {
        for key in keys {
            let Some(share) = self.by_key.get_mut(key) else { continue };
            share.users = share.users.saturating_sub(1);
            if share.users == 0 {
                self.all.cpu = self.all.cpu.saturating_sub(share.cpu_bytes);
                self.all.gpu = self.all.gpu.saturating_sub(share.gpu());
                self.by_key.remove(key);
            }
        }
    }
}

fn keys(page: &Page) -> impl Iterator<Item = &ContentKey> {
    page.shared_contents().iter().map(|used| &used.content.key)
}
