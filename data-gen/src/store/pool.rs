//! The most recently used of many open files.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};

use lru::LruCache;

use crate::GenError;

/// The largest number of files that stay open. Operating systems allow a process from 256 on.
const MAX_OPEN: NonZeroUsize = NonZeroUsize::new(64).expect("64 is not 0");

/// Open files by the numbers of their images. All threads share it.
pub(crate) struct Pool<T> {
    open: Mutex<LruCache<u64, Arc<T>>>,
    next: std::sync::atomic::AtomicU64,
}

impl<T> Pool<T> {
    pub fn new() -> Self {
        Self { open: Mutex::new(LruCache::new(MAX_OPEN)), next: std::sync::atomic::AtomicU64::new(0) }
    }

    /// Returns a number for a file that no other file of this pool has.
    pub fn new_file(&self) -> u64 {
        self.next.fetch_add(1, std::sync::atomic::Ordering::Relaxed)
    }

    /// Returns the file with a number, opened if it is not among the most recently used ones. Two threads may open it at the
    /// same time; then one of both is kept.
    pub fn file(&self, number: u64, open: impl FnOnce() -> Result<T, GenError>) -> Result<Arc<T>, GenError> {
        let lock = || self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(file) = lock().get(&number) {
            return Ok(Arc::clone(file));
        }
        let file = Arc::new(open()?);
        // The file that leaves the pool is closed without the lock.
        let closed = lock().push(number, Arc::clone(&file));
        drop(closed);
        Ok(file)
    }
}
