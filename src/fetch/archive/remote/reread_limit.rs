//! [`RereadLimit`]: how often the directory of an archive is read again because it may be damaged.
//!
//! Directories have no checksum. One that was damaged in transfer leads to wrong bytes for as long as it is cached.

use std::num::NonZeroUsize;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;

/// The interval between the first two rereads of one archive. It doubles with each reread.
const FIRST_INTERVAL: Duration = Duration::from_secs(2);
/// The longest interval. It is shorter than the time for which invalid content is retried.
const MAX_INTERVAL: Duration = Duration::from_secs(30);
/// The number of archives whose intervals are remembered.
const MAX_ARCHIVES: NonZeroUsize = NonZeroUsize::new(256).expect("not zero");

/// The time of the next permitted reread, and the interval after it, by URL of the archive. Locked briefly.
#[derive(Debug)]
pub(super) struct RereadLimit(Mutex<LruCache<String, (Instant, Duration)>>);

impl RereadLimit {
    pub fn new() -> Self {
        Self(Mutex::new(LruCache::new(MAX_ARCHIVES)))
    }

    /// Reports an invalid member of an archive. Returns true if its directory may be read again now. The growing intervals
    /// limit the cost of broken members in an intact archive.
    pub fn allows(&self, url: &str, now: Instant) -> bool {
        let mut limits = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (at, interval) = limits.get_or_insert_mut(url.to_owned(), || (now, FIRST_INTERVAL));
        let is_due = *at <= now;
        if is_due {
            (*at, *interval) = (now + *interval, (2 * *interval).min(MAX_INTERVAL));
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broken_members_reread_the_directory_at_growing_intervals() {
        let (limit, start) = (RereadLimit::new(), Instant::now());
        let is_read_at = |second: u64| limit.allows("http://h/a.zip", start + Duration::from_secs(second));
        let read: Vec<u64> = (0..120).filter(|second| is_read_at(*second)).collect();
        assert_eq!(read, [0, 2, 6, 14, 30, 60, 90]);
        assert!(limit.allows("http://h/b.zip", start));
    }
}
