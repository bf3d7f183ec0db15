//! Counters of a cache, incremented by any thread.

use std::sync::atomic::{AtomicU64, Ordering};

use super::stats::CacheStats;

/// [`CacheStats`] as atomic integers.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub hits: AtomicU64,
    pub revalidated: AtomicU64,
    pub misses: AtomicU64,
    pub stored: AtomicU64,
    pub too_large: AtomicU64,
    pub evicted: AtomicU64,
    pub corrupt: AtomicU64,
    pub write_errors: AtomicU64,
    pub bypassed: AtomicU64,
    pub bytes_hit: AtomicU64,
    pub bytes_stored: AtomicU64,
}

/// Adds to a counter.
pub(super) fn add(counter: &AtomicU64, more: u64) {
    counter.fetch_add(more, Ordering::Relaxed);
}

impl Counters {
    pub fn snapshot(&self) -> CacheStats {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        CacheStats {
            hits: of(&self.hits),
            revalidated: of(&self.revalidated),
            misses: of(&self.misses),
            stored: of(&self.stored),
            too_large: of(&self.too_large),
            evicted: of(&self.evicted),
            corrupt: of(&self.corrupt),
            write_errors: of(&self.write_errors),
            bypassed: of(&self.bypassed),
            bytes_hit: of(&self.bytes_hit),
            bytes_stored: of(&self.bytes_stored),
        }
    }
}
