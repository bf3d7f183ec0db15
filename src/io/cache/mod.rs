//! What came from servers, kept on disk: bodies by the hash of their content, and beside them what each URI had.
//!
//! ```text
//! DIR/terrane-cache   says that the folder is one
//! DIR/keys/ab/…       by the hash of a URI (and of where its store is): validators, how long it is fresh, the hash of its body
//! DIR/blobs/ab/…      by the hash of the content, as it came over the network; its file time is its last use
//! DIR/tmp/…           being written
//! DIR/limit           how many bytes it may have
//! DIR/lock            held while old entries are removed
//! ```
//! Every file is written beside its place and renamed into it, and checked by its hash when it is read: a killed
//! process leaves nothing broken, and several processes may use one folder at once. Nothing here waits for another
//! process. All of it blocks on the disk: called from the HTTP thread's own blocking threads, never from the frame's.

#[cfg(feature = "http")]
mod check;
#[cfg(feature = "http")]
mod entry;
#[cfg(feature = "http")]
mod files;
#[cfg(feature = "http")]
mod freshness;
mod stats;
#[cfg(feature = "http")]
mod store;
#[cfg(feature = "http")]
mod sweep;

#[cfg(feature = "http")]
pub use check::{CacheInfo, CacheVerified};
#[cfg(feature = "http")]
pub(crate) use entry::Entry;
#[cfg(feature = "http")]
#[doc(hidden)]
pub use entry::fuzz_cache_entry;
#[cfg(feature = "http")]
pub(crate) use freshness::Freshness;
pub use stats::CacheStats;
#[cfg(feature = "http")]
pub use store::{CacheConfig, DiskCache};
