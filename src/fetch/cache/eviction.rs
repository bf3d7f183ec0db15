//! [`Eviction`]: keeps the cache below its size limit. The least recently used files are removed first.
//!
//! Each process adds up the bytes that it writes. It scans the folder once they exceed a sixteenth of the limit, so that
//! the writes of other processes count too. Only one process removes files at a time; the others continue meanwhile.

use std::fs;
use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::files::{Files, Found, Hash, LOCK};

/// An eviction frees this fraction of the limit: one tenth.
const FREED_FRACTION: u64 = 10;
/// The shortest interval between evictions on a full disk. Other programs may be filling it.
const FULL_DISK_INTERVAL: Duration = Duration::from_secs(5);

/// The size of a cache as far as this process knows it, and the removal of files beyond the limit.
#[derive(Debug)]
pub(super) struct Eviction {
    max_bytes: u64,
    /// Locked briefly; the folder is scanned without the lock.
    size: Mutex<KnownSize>,
}

#[derive(Debug, Default)]
struct KnownSize {
    /// Size in bytes at the last scan; `None` before the first.
    scanned_bytes: Option<u64>,
    /// Bytes written since by this process.
    written_bytes: u64,
    /// True while a thread scans. The others continue meanwhile.
    is_scanning: bool,
    /// The time at which the disk was last found full.
    full_at: Option<Instant>,
}

impl KnownSize {
    fn is_scan_due(&self, max_bytes: u64) -> bool {
        match self.scanned_bytes {
            _ if self.is_scanning => false,
            None => true,
            Some(scanned) => self.written_bytes > max_bytes / 16 || scanned + self.written_bytes > max_bytes,
        }
    }
}

/// The result of [`Eviction::evict_to`].
#[derive(Debug, PartialEq, Eq)]
struct Evicted {
    /// Bytes of all files after the eviction.
    bytes_left: u64,
    /// Number of bodies removed.
    bodies: u64,
}

impl Eviction {
    pub fn new(max_bytes: u64) -> Self {
        Self { max_bytes, size: Mutex::default() }
    }

    /// Counts bytes written with the body `newest`, and removes old files if a scan is due. Returns the number of bodies
    /// removed.
    pub fn after_write(&self, files: &Files, newest: &Hash, bytes: u64) -> io::Result<u64> {
        let mut size = self.lock();
        size.written_bytes += bytes;
        if !size.is_scan_due(self.max_bytes) {
            return Ok(0);
        }
        // Bytes written from now on count for the next scan, whether this one sees them or not.
        size.is_scanning = true;
        let counted_bytes = std::mem::take(&mut size.written_bytes);
        drop(size);
        let evicted = evict_to(files, self.max_bytes, newest);
        self.finish_scan(evicted.as_ref().ok().and_then(Option::as_ref), evicted.is_err());
        if matches!(evicted, Ok(None)) {
            // The other process may have scanned before these writes, so the next one tries again.
            self.lock().written_bytes += counted_bytes;
        }
        evicted.map(|evicted| evicted.map_or(0, |evicted| evicted.bodies))
    }

    /// Frees space on a full disk: down to the limit, which may have been lowered, or by the size of the new body. Returns
    /// the number of bodies removed, or `None` if a retry of the write is pointless now.
    pub fn on_full_disk(&self, files: &Files, newest: &Hash, body_bytes: u64) -> Option<u64> {
        let mut size = self.lock();
        if size.is_scanning || size.full_at.is_some_and(|before| before.elapsed() < FULL_DISK_INTERVAL) {
            return None;
        }
        (size.is_scanning, size.full_at) = (true, Some(Instant::now()));
        drop(size);
        let evict = |bytes: u64| evict_to(files, self.max_bytes.min(bytes.saturating_sub(body_bytes)), newest);
        // The caller reports the failed write; another failure here adds nothing.
        let evicted = files.bytes().and_then(evict).ok().flatten();
        self.finish_scan(evicted.as_ref(), false);
        evicted.map(|evicted| evicted.bodies)
    }

    fn lock(&self) -> MutexGuard<'_, KnownSize> {
        self.size.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records the result of a scan: `None` if another process is evicting, or if the scan failed.
    fn finish_scan(&self, evicted: Option<&Evicted>, has_failed: bool) {
        let mut size = self.lock();
        size.is_scanning = false;
        if let Some(evicted) = evicted {
            size.scanned_bytes = Some(evicted.bytes_left);
        } else if has_failed {
            // The next scan is due after as many writes as after a successful one.
            size.scanned_bytes.get_or_insert(0);
        }
    }
}

/// If the files exceed the limit, removes the least recently used until nine tenths of it remain. Returns `None` if another
/// process is evicting. The newest body is removed last: file times are too coarse to distinguish it from those written
/// just before, and clocks may be wrong.
fn evict_to(files: &Files, max_bytes: u64, newest: &Hash) -> io::Result<Option<Evicted>> {
    let lock = fs::File::options().create(true).truncate(false).write(true).open(files.folder.join(LOCK))?;
    match lock.try_lock() {
        Ok(()) => {}
        Err(fs::TryLockError::WouldBlock) => return Ok(None),
        // The file system has no locks: two processes that evict at once remove a little too much.
        Err(fs::TryLockError::Error(e)) => log::debug!("cache {}: no file lock: {e}", files.folder.display()),
    }
    // Closing the file releases the lock, also if the process is killed.
    files.remove_leftovers()?;
    let (blobs, keys) = (files.scan("blobs")?, files.scan("keys")?);
    let size = |files: &[Found]| files.iter().map(|f| f.size).sum::<u64>();
    let mut bytes_left = size(&blobs) + size(&keys);
    let mut bodies = 0;
    if bytes_left <= max_bytes {
        return Ok(Some(Evicted { bytes_left, bodies }));
    }
    // A body is touched whenever one of its keys is, so it is removed about when the last of them is.
    let blobs = blobs.into_iter().map(|blob| (blob.hash == *newest, blob.modified, true, blob));
    let keys = keys.into_iter().map(|key| (false, key.modified, false, key));
    let mut oldest_first: Vec<_> = blobs.chain(keys).collect();
    oldest_first.sort_by_key(|(is_newest, modified, is_blob, file)| (*is_newest, *modified, *is_blob, file.hash));
    let mut oldest_first = oldest_first.into_iter();
    while bytes_left > max_bytes - max_bytes / FREED_FRACTION
        && let Some((_, _, is_blob, oldest)) = oldest_first.next()
    {
        if fs::remove_file(&oldest.path).is_ok() {
            bytes_left -= oldest.size;
            bodies += u64::from(is_blob);
        }
    }
    Ok(Some(Evicted { bytes_left, bodies }))
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::super::files::hash;
    use super::*;

    /// Other writers used to wait for the scanning thread, and all reads from the cache with them.
    #[test]
    fn other_threads_continue_while_one_scans() {
        let folder = tempfile::tempdir().unwrap();
        let files = Files::open(folder.path()).unwrap();
        let eviction = Eviction::new(1000);
        let body = hash(b"body");
        eviction.lock().is_scanning = true;
        eviction.after_write(&files, &body, 5000).unwrap();
        let known = || {
            let size = eviction.lock();
            (size.scanned_bytes, size.written_bytes)
        };
        assert_eq!(known(), (None, 5000));
        eviction.lock().is_scanning = false;
        eviction.after_write(&files, &body, 1).unwrap();
        assert_eq!(known(), (Some(0), 0));
    }

    /// Their bytes used to be forgotten, so that several busy processes could leave the cache beyond its limit.
    #[test]
    fn writes_while_another_process_evicts_are_counted_later() {
        let folder = tempfile::tempdir().unwrap();
        let files = Files::open(folder.path()).unwrap();
        let eviction = Eviction::new(1000);
        let body = hash(b"body");
        eviction.after_write(&files, &body, 1).unwrap();
        // A lock of another handle is one of another process.
        let other = fs::File::options().write(true).open(files.folder.join(LOCK)).unwrap();
        other.lock().unwrap();
        eviction.after_write(&files, &body, 100).unwrap();
        assert_eq!(eviction.lock().written_bytes, 100);
        drop(other);
        eviction.after_write(&files, &body, 1).unwrap();
        assert_eq!(eviction.lock().written_bytes, 0);
    }

    #[test]
    fn least_recently_used_go_first_and_the_newest_last() {
        let folder = tempfile::tempdir().unwrap();
        let files = Files::open(folder.path()).unwrap();
        let (now, day) = (SystemTime::now(), Duration::from_secs(24 * 3600));
        // In the order of eviction. A time in the future tells nothing about the last use.
        let times = [now + 1000 * day, now - 3 * day, now - 2 * day, now - day, now - 4 * day];
        let bodies: Vec<Hash> = (0..5u8).map(|i| hash(&[i; 100])).collect();
        let newest = bodies[4];
        for (i, (body, time)) in bodies.iter().zip(times).enumerate() {
            let path = files.blob(body);
            files.write(&path, &[i as u8; 100]).unwrap();
            fs::File::options().write(true).open(path).unwrap().set_modified(time).unwrap();
        }
        for (max_bytes, gone) in [(500, 0), (400, 2), (299, 3), (150, 4)] {
            evict_to(&files, max_bytes, &newest).unwrap();
            let left: Vec<bool> = bodies.iter().map(|body| files.blob(body).exists()).collect();
            assert_eq!(left, (0..5).map(|i| i >= gone).collect::<Vec<_>>(), "{max_bytes}");
        }
    }
}
