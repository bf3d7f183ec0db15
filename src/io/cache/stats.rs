//! Counters of the cache on disk.

use serde::{Deserialize, Serialize};

/// What a cache did since it was opened by this process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CacheStats {
    /// Answers from the disk alone.
    pub hits: u64,
    /// Answers from the disk after the server said that they still hold.
    pub revalidated: u64,
    /// Answers that were not there, or no longer held.
    pub misses: u64,
    /// Bodies kept.
    pub stored: u64,
    /// Bodies that were not kept, each larger than an eighth of what the cache may have.
    #[serde(default)]
    pub too_large: u64,
    /// Bodies removed for others.
    pub evicted: u64,
    /// Entries that were not as they had been written, and were removed.
    pub corrupt: u64,
    /// Entries that could not be written.
    pub write_errors: u64,
    /// Bytes of bodies that came from the disk.
    pub bytes_hit: u64,
    /// Bytes of bodies that were kept.
    pub bytes_stored: u64,
}
