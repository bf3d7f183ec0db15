//! A bounded cache of the directories below the root.

use std::num::NonZeroUsize;
use std::sync::{Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use crate::fetch::archive::evict_lru;

/// The maximum number of cached directories of one file.
const MAX_CACHED_DIRECTORIES: NonZeroUsize = NonZeroUsize::new(64).expect("not zero");
/// The maximum number of entries of all cached directories together, and of a single one: 32 MiB. The format's own writers
/// produce some thousand in each.
pub(super) const MAX_CACHED_ENTRIES: usize = 1 << 20;
/// The most recently used directories by their offsets in the file.
#[derive(Debug)]
pub(in crate::fetch::archive) struct DirectoryCache<D>(
    /// Locked briefly by the threads that read tiles; directories are read without the lock.
    Mutex<LruCache<u64, D>>,
);

impl<D: Clone> DirectoryCache<D> {
    pub fn new() -> Self {
        Self(Mutex::new(LruCache::new(MAX_CACHED_DIRECTORIES)))
    }

    fn lock(&self) -> MutexGuard<'_, LruCache<u64, D>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn get(&self, offset: u64) -> Option<D> {
        self.lock().get(&offset).cloned()
    }

    #[cfg(feature = "http")]
    pub fn get_or_insert(&self, offset: u64, make: impl FnOnce() -> D) -> D {
        self.lock().get_or_insert(offset, make).clone()
    }

    pub fn put(&self, offset: u64, directory: D) {
        self.lock().put(offset, directory);
    }

    /// Removes the least recently used directories until all together have at most [`MAX_CACHED_ENTRIES`]. `entries` counts
    /// the entries of one directory.
    pub fn evict(&self, entries: impl Fn(&D) -> usize) {
        evict_lru(&mut self.lock(), MAX_CACHED_ENTRIES, entries);
    }

    /// Returns the sum of the sizes of all cached directories.
    pub fn sum(&self, size: impl Fn(&D) -> usize) -> usize {
        self.lock().iter().map(|(_, directory)| size(directory)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_of_directories_and_of_entries_is_bounded() {
        let cache = DirectoryCache::new();
        for offset in 0..100 {
            cache.put(offset, MAX_CACHED_ENTRIES / 10);
            cache.evict(|entries| *entries);
        }
        let there = |cache: &DirectoryCache<usize>, all: u64| (0..all).filter(|o| cache.get(*o).is_some()).count();
        assert_eq!(there(&cache, 100), 10);
        assert!(cache.get(99).is_some() && cache.get(90).is_some());
        cache.put(100, MAX_CACHED_ENTRIES);
        cache.evict(|entries| *entries);
        assert_eq!((there(&cache, 101), cache.get(100)), (1, Some(MAX_CACHED_ENTRIES)));
        for offset in 0..100 {
            cache.put(offset, 1);
            cache.evict(|entries| *entries);
        }
        assert_eq!(there(&cache, 101), MAX_CACHED_DIRECTORIES.get());
    }
}
