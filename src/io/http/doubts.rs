//! When an archive is read anew because what was read of it may be wrong: directories have no checksum, and one that was
//! changed on its way leads to the wrong bytes for as long as it is kept. Whoever reads files of archives.

use std::num::NonZeroUsize;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;

/// The first time at once, then after so long, twice as long each time.
const FIRST_WAIT: Duration = Duration::from_secs(2);
/// Shorter than what is no content is tried for.
const LONGEST_WAIT: Duration = Duration::from_secs(30);
/// Archives that are remembered.
const REMEMBERED: NonZeroUsize = NonZeroUsize::new(256).expect("not zero");

/// By URL: when an archive may be read anew again, and the wait after that. Taken for moments.
#[derive(Debug)]
pub(super) struct Doubts(Mutex<LruCache<String, (Instant, Duration)>>);

impl Doubts {
    pub fn new() -> Self {
        Self(Mutex::new(LruCache::new(REMEMBERED)))
    }

    /// A file of an archive was not what it should be: whether the archive is to be read anew. Broken files in a good one
    /// cost its directory seldom.
    pub fn count(&self, url: &str, now: Instant) -> bool {
        let mut doubts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (at, wait) = doubts.get_or_insert_mut(url.to_owned(), || (now, FIRST_WAIT));
        let is_due = *at <= now;
        if is_due {
            (*at, *wait) = (now + *wait, (2 * *wait).min(LONGEST_WAIT));
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broken_files_cost_their_directory_at_growing_intervals() {
        let (doubts, start) = (Doubts::new(), Instant::now());
        let is_read_at = |second: u64| doubts.count("http://h/a.zip", start + Duration::from_secs(second));
        let read: Vec<u64> = (0..120).filter(|second| is_read_at(*second)).collect();
        assert_eq!(read, [0, 2, 6, 14, 30, 60, 90]);
        assert!(doubts.count("http://h/b.zip", start));
    }
}
