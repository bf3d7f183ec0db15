//! [`CacheStats`]: statistics of the disk cache for reports.

use serde::{Deserialize, Serialize};

/// Counters of a disk cache since this process opened it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CacheStats {
    /// Answers from the disk without asking a server.
    pub hits: u64,
    /// Answers from the disk that the server confirmed.
    pub revalidated: u64,
    /// Cache misses: the answer was missing or no longer valid.
    pub misses: u64,
    /// Bodies stored.
    pub stored: u64,
    /// Bodies not stored because they are larger than an eighth of the size limit.
    #[serde(default)]
    pub too_large: u64,
    /// Bodies evicted to make room for others.
    pub evicted: u64,
    /// Damaged entries that were removed.
    pub corrupt: u64,
    /// Entries that could not be written to disk.
    pub write_errors: u64,
    /// Reads and writes that were left out because the disk did not answer in time.
    #[serde(default)]
    pub bypassed: u64,
    /// Bytes of bodies read from the disk.
    pub bytes_hit: u64,
    /// Bytes of bodies stored.
    pub bytes_stored: u64,
}
