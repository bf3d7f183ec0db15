//! A disk cache for answers of servers: bodies by the hash of their content, and one entry of metadata per URI.
//!
//! ```text
//! DIR/terrane-cache   marks the folder as a cache
//! DIR/keys/ab/…       entries by the hash of URI, store location and credentials: validators, freshness, hash of the body
//! DIR/blobs/ab/…      bodies as received, by the hash of their content; the file time is the last use
//! DIR/tmp/…           files being written
//! DIR/limit           the size limit in bytes
//! DIR/secret          the secret with which credentials are hashed
//! DIR/index.redb      sizes and last uses of all files, for eviction; rebuilt from them if it is missing or broken
//! DIR/changes/…       files that the index does not have yet, one list for each process
//! DIR/lock            locked during eviction
//! ```
//! Every file is written under a temporary name, renamed, and checked by its hash when it is read. So a killed process
//! leaves nothing broken, and several processes may use one folder at the same time without waiting for each other. All
//! functions block on the disk: they are called on the HTTP thread's blocking threads, never on the threads of the frame.

#[cfg(feature = "http")]
mod changes;
#[cfg(feature = "http")]
mod counters;
#[cfg(feature = "http")]
mod entry;
#[cfg(feature = "http")]
mod eviction;
#[cfg(feature = "http")]
mod files;
#[cfg(feature = "http")]
mod freshness;
#[cfg(feature = "http")]
mod index;
#[cfg(feature = "http")]
mod key;
#[cfg(feature = "http")]
mod maintenance;
mod stats;
#[cfg(feature = "http")]
mod store;

#[cfg(feature = "http")]
pub(crate) use entry::Entry;
#[cfg(all(feature = "http", feature = "testing"))]
pub use entry::fuzz_cache_entry;
#[cfg(feature = "http")]
pub(crate) use freshness::Freshness;
#[cfg(feature = "http")]
pub(crate) use key::Asker;
#[cfg(feature = "object-store")]
pub(crate) use key::StoreAsker;
#[cfg(feature = "http")]
pub use maintenance::{CacheInfo, CacheVerified};
pub use stats::CacheStats;
#[cfg(feature = "http")]
pub use store::{CacheConfig, DiskCache};
