//! Reference counts of the contents that pages share, and their memory, each content once. Update thread.

use std::collections::HashMap;

use super::budget::MemoryUse;
use crate::scene::{ContentKey, Page};

/// One shared content.
#[derive(Debug, Default)]
struct Content {
    /// Pages that use it, including those that have arrived and are not merged.
    users: u32,
    /// Users that are merged, or about to be.
    merged: u32,
    cpu_bytes: u64,
    /// By context id.
    gpu_bytes: Vec<(u32, u64)>,
}

impl Content {
    fn gpu(&self) -> u64 {
        self.gpu_bytes.iter().map(|(_, bytes)| bytes).sum()
    }

    fn bytes(&self) -> MemoryUse {
        MemoryUse { cpu: self.cpu_bytes, gpu: self.gpu() }
    }
}

/// Shared contents by key; looked up by key, and iterated only when a context closes.
#[derive(Debug, Default)]
pub(super) struct ContentUsers {
    by_key: HashMap<ContentKey, Content>,
    merged: MemoryUse,
    all: MemoryUse,
    saved: MemoryUse,
}

impl ContentUsers {
    /// Returns the memory of the contents that merged pages use.
    pub fn merged(&self) -> MemoryUse {
        self.merged
    }

    /// Returns the memory of all contents, including those that only arrived pages use.
    pub fn all(&self) -> MemoryUse {
        self.all
    }

    /// Returns the additional memory that merged pages would take if each had its own copy.
    pub fn saved(&self) -> MemoryUse {
        self.saved
    }

    /// Counts a page that has arrived as a user of its contents.
    pub fn add_user(&mut self, page: &Page) {
        for used in page.shared_contents() {
            let content = self.by_key.entry(used.content.key).or_default();
            content.users += 1;
            let more = used.tree_bytes.saturating_sub(content.cpu_bytes);
            content.cpu_bytes += more;
            self.all.cpu += more;
            if let Some(others) = content.merged.checked_sub(1) {
                self.merged.cpu += more;
                self.saved.cpu += u64::from(others) * more;
            }
        }
    }

    /// Removes a page that is dropped from the users of its contents; the opposite of [`Self::add_user`].
    pub fn remove_user(&mut self, page: &Page) {
        self.remove_user_of(keys(page));
    }

    /// Notes the sizes of contents that a context has uploaded.
    pub fn uploaded(&mut self, context: u32, shared: &[(ContentKey, u64)]) {
        for (key, bytes) in shared {
            let Some(content) = self.by_key.get_mut(key) else { continue };
            let before = content.gpu();
            match content.gpu_bytes.iter_mut().find(|(id, _)| *id == context) {
                Some((_, known)) => *known = *bytes,
                None => content.gpu_bytes.push((context, *bytes)),
            }
            let after = content.gpu();
            self.all.gpu = self.all.gpu + after - before;
            if let Some(others) = content.merged.checked_sub(1) {
                self.merged.gpu = self.merged.gpu + after - before;
                self.saved.gpu = self.saved.gpu + u64::from(others) * after - u64::from(others) * before;
            }
        }
    }

    /// Forgets what a context held that has closed.
    pub fn forget_context(&mut self, context: u32) {
        for content in self.by_key.values_mut() {
            let Some(index) = content.gpu_bytes.iter().position(|(id, _)| *id == context) else { continue };
            let (_, bytes) = content.gpu_bytes.swap_remove(index);
            self.all.gpu -= bytes;
            if let Some(others) = content.merged.checked_sub(1) {
                self.merged.gpu -= bytes;
                self.saved.gpu -= u64::from(others) * bytes;
            }
        }
    }

    /// Returns the memory of a page's shared contents.
    pub fn bytes_of(&self, page: &Page) -> MemoryUse {
        self.used_by(page).fold(MemoryUse::default(), |sum, content| sum + content.bytes())
    }

    /// Returns the memory of the contents that only this page uses.
    pub fn bytes_only_of(&self, page: &Page) -> MemoryUse {
        let own = self.used_by(page).filter(|content| content.users == 1);
        own.fold(MemoryUse::default(), |sum, content| sum + content.bytes())
    }

    fn used_by<'a>(&'a self, page: &'a Page) -> impl Iterator<Item = &'a Content> {
        keys(page).filter_map(|key| self.by_key.get(key))
    }

    /// Counts a page as merged; contents that no merged page used count as merged from now on.
    pub fn merge(&mut self, page: &Page) {
        for key in keys(page) {
            let Some(content) = self.by_key.get_mut(key) else { continue };
            content.merged += 1;
            let sum = if content.merged == 1 { &mut self.merged } else { &mut self.saved };
            *sum = *sum + content.bytes();
        }
    }

    /// Counts a page as no longer merged; the opposite of [`Self::merge`].
    pub fn unmerge(&mut self, page: &Page) {
        self.unmerge_of(keys(page));
    }

    /// Forgets a merged page that shared these contents and that the application took out of its scene.
    pub fn forget_merged(&mut self, shared: &[ContentKey]) {
        self.unmerge_of(shared.iter());
        self.remove_user_of(shared.iter());
    }

    fn unmerge_of<'a>(&mut self, keys: impl Iterator<Item = &'a ContentKey>) {
        for key in keys {
            let Some(content) = self.by_key.get_mut(key) else { continue };
            content.merged = content.merged.saturating_sub(1);
            let sum = if content.merged == 0 { &mut self.merged } else { &mut self.saved };
            subtract(sum, content.bytes());
        }
    }

    fn remove_user_of<'a>(&mut self, keys: impl Iterator<Item = &'a ContentKey>) {
        for key in keys {
            let Some(content) = self.by_key.get_mut(key) else { continue };
            content.users = content.users.saturating_sub(1);
            if content.users == 0 {
                subtract(&mut self.all, content.bytes());
                self.by_key.remove(key);
            }
        }
    }
}

fn subtract(sum: &mut MemoryUse, bytes: MemoryUse) {
    sum.cpu = sum.cpu.saturating_sub(bytes.cpu);
    sum.gpu = sum.gpu.saturating_sub(bytes.gpu);
}

fn keys(page: &Page) -> impl Iterator<Item = &ContentKey> {
    page.shared_contents().iter().map(|used| &used.content.key)
}
