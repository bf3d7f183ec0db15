//! Keeping the size: the entries used longest ago go first.
//!
//! Each process adds up what it writes and looks at the folder itself once that is a sixteenth of the limit, so that
//! what others write counts too. One process at a time removes; the others go on.

use std::fs;
use std::io;
use std::time::{Duration, Instant};

use super::files::{Found, Hash, LOCK};
use super::store::{DiskCache, add, lock};

/// Room that is made at once, of the limit.
const FREED_SHARE: u64 = 10;
/// On a full disk room is made at most so often: it may be others who fill it.
const FULL_EVERY: Duration = Duration::from_secs(5);

/// What a process knows of the size.
#[derive(Debug)]
pub(super) struct Room {
    max_bytes: u64,
    /// At the last look; `None` before the first.
    seen_bytes: Option<u64>,
    /// Written since by this process.
    written_bytes: u64,
    /// A thread is looking; the others go on meanwhile.
    is_swept: bool,
    /// When the disk was last found full.
    full: Option<Instant>,
}

impl Room {
    pub fn new(max_bytes: u64) -> Self {
        Self { max_bytes, seen_bytes: None, written_bytes: 0, is_swept: false, full: None }
    }

    fn is_due(&self) -> bool {
        match self.seen_bytes {
            _ if self.is_swept => false,
            None => true,
            Some(seen) => self.written_bytes > self.max_bytes / 16 || seen + self.written_bytes > self.max_bytes,
        }
    }
}

impl DiskCache {
    /// Counts what was written with a body and makes room where it is due.
    pub(super) fn made_larger(&self, newest: &Hash, bytes: u64) {
        let mut room = lock(&self.room);
        room.written_bytes += bytes;
        if !room.is_due() {
            return;
        }
        // What others write from now on counts for the next time, whether this look meets it or not.
        (room.is_swept, room.written_bytes) = (true, 0);
        let max_bytes = room.max_bytes;
        drop(room);
        let left = self.sweep(max_bytes, newest);
        self.looked(left);
    }

    /// Makes room where the disk has none for a body: down to the limit, which may have been another one, or by as much
    /// as the body takes. Whether to try again.
    pub(super) fn makes_room_on_disk(&self, newest: &Hash, size: u64) -> bool {
        let mut room = lock(&self.room);
        if room.is_swept || room.full.is_some_and(|before| before.elapsed() < FULL_EVERY) {
            return false;
        }
        (room.is_swept, room.full) = (true, Some(Instant::now()));
        let max_bytes = room.max_bytes;
        drop(room);
        let there = self.files.bytes();
        let left = there.and_then(|there| self.sweep(max_bytes.min(there.saturating_sub(size)), newest));
        let is_done = matches!(left, Ok(Some(_)));
        // A failure here is said as that of the write.
        self.looked(left.or(Ok(None)));
        is_done
    }

    fn looked(&self, left: io::Result<Option<u64>>) {
        let mut room = lock(&self.room);
        room.is_swept = false;
        match left {
            Ok(Some(left)) => room.seen_bytes = Some(left),
            // Another process is at it.
            Ok(None) => {}
            Err(e) => {
                // Not again before as much has been written as after a look.
                room.seen_bytes.get_or_insert(0);
                self.say(&e);
            }
        }
    }

    /// Removes down to nine tenths of the limit where there is more than it; says what is left. `None` where another
    /// process is doing the same. The newest body goes last of all: file times are too coarse to tell it from those
    /// written just before, and clocks may be wrong.
    pub(super) fn sweep(&self, max_bytes: u64, newest: &Hash) -> io::Result<Option<u64>> {
        let file = fs::File::options().create(true).truncate(false).write(true).open(self.files.folder.join(LOCK))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => return Ok(None),
            // A file system without locks: two that sweep at once remove a little more than they had to.
            Err(fs::TryLockError::Error(e)) => log::debug!("cache: no lock: {e}"),
        }
        // The lock goes with the file, also when the process is killed.
        self.files.remove_left_overs()?;
        let (blobs, keys) = (self.files.scan("blobs")?, self.files.scan("keys")?);
        let size = |files: &[Found]| files.iter().map(|f| f.size).sum::<u64>();
        let mut left = size(&blobs) + size(&keys);
        if left <= max_bytes {
            return Ok(Some(left));
        }
        // A body is used whenever one of its keys is: it goes about when the last of them does.
        let blobs = blobs.into_iter().map(|blob| (blob.hash == *newest, blob.modified, true, blob));
        let keys = keys.into_iter().map(|key| (false, key.modified, false, key));
        let mut files: Vec<_> = blobs.chain(keys).collect();
        files.sort_by_key(|(is_newest, modified, is_blob, file)| (*is_newest, *modified, *is_blob, file.hash));
        let mut files = files.into_iter();
        while left > max_bytes - max_bytes / FREED_SHARE
            && let Some((_, _, is_blob, oldest)) = files.next()
        {
            if fs::remove_file(&oldest.path).is_ok() {
                left -= oldest.size;
                add(&self.counts.evicted, u64::from(is_blob));
            }
        }
        Ok(Some(left))
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::super::files::hash;
    use super::super::store::CacheConfig;
    use super::*;

    /// They stood behind the one that looked, and with them all that was read from the cache.
    #[test]
    fn while_one_thread_looks_the_others_go_on() {
        let folder = tempfile::tempdir().unwrap();
        let max_bytes = Some(1000);
        let cache = DiskCache::open(&CacheConfig { max_bytes, ..CacheConfig::new(folder.path()) }).unwrap();
        let body = hash(b"body");
        lock(&cache.room).is_swept = true;
        cache.made_larger(&body, 5000);
        let room = || {
            let room = lock(&cache.room);
            (room.seen_bytes, room.written_bytes)
        };
        assert_eq!(room(), (None, 5000));
        lock(&cache.room).is_swept = false;
        cache.made_larger(&body, 1);
        assert_eq!(room(), (Some(0), 0));
    }

    #[test]
    fn the_longest_unused_go_first_and_the_newest_last() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(&CacheConfig::new(folder.path())).unwrap();
        let (now, day) = (SystemTime::now(), Duration::from_secs(24 * 3600));
        // In the order in which they go; a time that has yet to come says nothing of a use.
        let times = [now + 1000 * day, now - 3 * day, now - 2 * day, now - day, now - 4 * day];
        let bodies: Vec<Hash> = (0..5u8).map(|i| hash(&[i; 100])).collect();
        let newest = bodies[4];
        for (i, (body, time)) in bodies.iter().zip(times).enumerate() {
            let path = cache.files.blob(body);
            cache.files.write(&path, &[i as u8; 100]).unwrap();
            fs::File::options().write(true).open(path).unwrap().set_modified(time).unwrap();
        }
        for (max_bytes, gone) in [(500, 0), (400, 2), (299, 3), (150, 4)] {
            cache.sweep(max_bytes, &newest).unwrap();
            let left: Vec<bool> = bodies.iter().map(|body| cache.files.blob(body).exists()).collect();
            assert_eq!(left, (0..5).map(|i| i >= gone).collect::<Vec<_>>(), "{max_bytes}");
        }
    }
}
