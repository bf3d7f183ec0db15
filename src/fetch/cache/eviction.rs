//! [`Eviction`]: keeps the cache below its size limit. The least recently used files are removed first. Any thread; one at a
//! time scans the folder.
//!
//! Each process adds up the bytes that it writes. It opens the index of the folder once they exceed a sixteenth of the limit,
//! so that the writes of other processes count too. Only one process removes files at a time; the others continue meanwhile.
//! Where the index cannot be written, as on a full disk, the folder is scanned instead.

use std::fs;
use std::io;
use std::panic::AssertUnwindSafe;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::changes::Changes;
use super::files::{FileId, Files, Found, Hash, Kind, LOCK};
use super::index::{Index, IndexError};

/// An eviction frees this fraction of the limit: one tenth.
const FREED_FRACTION: u64 = 10;
/// The shortest interval between evictions on a full disk. Other programs may be filling it.
const FULL_DISK_INTERVAL: Duration = Duration::from_secs(5);

/// An eviction is repeated up to this many times while others write.
const MAX_ROUNDS: usize = 16;

/// The size of a cache as far as this process knows it, and the removal of files beyond the limit.
#[derive(Debug)]
pub(super) struct Eviction {
    max_bytes: u64,
    /// Locked briefly; files are removed without the lock.
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

/// The result of an eviction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
        let evicted = evict(files, newest, |bytes| goal(bytes, self.max_bytes));
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
        let goal_of = |bytes: u64| goal(bytes, self.max_bytes.min(bytes.saturating_sub(body_bytes)));
        // The caller reports the failed write; another failure here adds nothing.
        let evicted = evict(files, newest, goal_of).ok().flatten();
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

/// Returns the size down to which files are removed: if they exceed the limit, nine tenths of it.
fn goal(bytes: u64, max_bytes: u64) -> u64 {
    if bytes <= max_bytes { bytes } else { max_bytes - max_bytes / FREED_FRACTION }
}

/// Removes the least recently used files down to the size that `goal_of` returns for the size of all files. Returns `None` if
/// another process is evicting. The newest body is removed last: file times are too coarse to distinguish it from those
/// written just before, and clocks may be wrong.
fn evict(files: &Files, newest: &Hash, goal_of: impl Fn(u64) -> u64) -> io::Result<Option<Evicted>> {
    let mut evicted = None;
    for _ in 0..MAX_ROUNDS {
        let Some(Evicted { bytes_left, bodies }) = evict_once(files, newest, &goal_of)? else { break };
        let before = evicted.map_or(0, |evicted: Evicted| evicted.bodies);
        evicted = Some(Evicted { bytes_left, bodies: before + bodies });
        // Others may have written meanwhile and found the lock taken. It is free again.
        if !Changes::are_waiting(files) {
            break;
        }
    }
    Ok(evicted)
}

fn evict_once(files: &Files, newest: &Hash, goal_of: impl Fn(u64) -> u64) -> io::Result<Option<Evicted>> {
    let lock = fs::File::options().create(true).truncate(false).write(true).open(files.folder.join(LOCK))?;
    match lock.try_lock() {
        Ok(()) => {}
        Err(fs::TryLockError::WouldBlock) => return Ok(None),
        // The file system has no locks: two processes that evict at once remove a little too much.
        Err(fs::TryLockError::Error(e)) => log::debug!("cache {}: no file lock: {e}", files.folder.display()),
    }
    // Closing the file releases the lock, also if the process is killed.
    files.remove_leftovers()?;
    for _ in 0..2 {
        match evict_by_index(files, newest, &goal_of) {
            Ok(evicted) => return Ok(Some(evicted)),
            Err(IndexError::Broken(reason)) => {
                log::info!("the index of the cache {} is rebuilt: {reason}", files.folder.display());
                files.remove_index();
            }
            // The disk may be full, or read-only for this user.
            Err(IndexError::Io(reason)) => {
                log::debug!("the index of the cache {} is not used: {reason}", files.folder.display());
                break;
            }
        }
    }
    // The next index is built from the files that the scan leaves.
    files.remove_index();
    Changes::take(files).discard();
    evict_by_scan(files, newest, goal_of).map(Some)
}

/// Evicts in the order of the index. Its cost depends on the number of files that are removed, and that were written or used
/// since the last eviction.
fn evict_by_index(files: &Files, newest: &Hash, goal_of: impl Fn(u64) -> u64) -> Result<Evicted, IndexError> {
    // A store that panics on a damaged file must not end the thread.
    let guarded = std::panic::catch_unwind(AssertUnwindSafe(|| {
        Index::open(files)?.with_files(|indexed| {
            let goal = goal_of(indexed.bytes());
            let newest = FileId::blob(*newest);
            let mut bodies = 0;
            let mut remove = |found: &Found| {
                let is_removed = fs::remove_file(&found.path).is_ok();
                bodies += u64::from(is_removed && found.id.kind == Kind::Blob);
                is_removed
            };
            // Files that stay although they are old: the newest body, and those that cannot be removed.
            let (mut kept, mut kept_bytes) = (Vec::new(), 0);
            while indexed.bytes() + kept_bytes > goal
                && let Some((id, last_use)) = indexed.take_oldest()?
            {
                let Some(found) = files.find(id) else { continue };
                if found.modified > last_use {
                    // Used since the index saw it last.
                    indexed.look_at(id)?;
                } else if id == newest || !remove(&found) {
                    kept_bytes += found.size;
                    kept.push(found);
                }
            }
            for found in kept {
                if found.id == newest && indexed.bytes() + kept_bytes > goal {
                    remove(&found);
                }
                indexed.look_at(found.id)?;
            }
            Ok(Evicted { bytes_left: indexed.bytes(), bodies })
        })
    }));
    guarded.unwrap_or_else(|_| Err(IndexError::Broken("the store panicked".to_owned())))
}

/// Evicts without an index: looks at all files.
fn evict_by_scan(files: &Files, newest: &Hash, goal_of: impl Fn(u64) -> u64) -> io::Result<Evicted> {
    let mut oldest_first = Vec::new();
    files.scan_each(|found| oldest_first.push(found))?;
    let mut bytes_left = oldest_first.iter().map(|found| found.size).sum::<u64>();
    let goal = goal_of(bytes_left);
    let mut bodies = 0;
    if bytes_left <= goal {
        return Ok(Evicted { bytes_left, bodies });
    }
    let newest = FileId::blob(*newest);
    // A body is touched whenever one of its keys is, so it is removed about when the last of them is.
    oldest_first.sort_by_key(|found| (found.id == newest, found.modified, found.id));
    let mut oldest_first = oldest_first.into_iter();
    while bytes_left > goal
        && let Some(oldest) = oldest_first.next()
    {
        if fs::remove_file(&oldest.path).is_ok() {
            bytes_left -= oldest.size;
            bodies += u64::from(oldest.id.kind == Kind::Blob);
        }
    }
    Ok(Evicted { bytes_left, bodies })
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::super::changes;
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

    /// Writes a body of 100 equal bytes that was last used at a time.
    fn write_body(files: &Files, byte: u8, last_use: SystemTime) -> Hash {
        let body = hash(&[byte; 100]);
        files.write(&files.blob(&body), &[byte; 100]).unwrap();
        use_body(files, &body, last_use);
        body
    }

    fn use_body(files: &Files, body: &Hash, last_use: SystemTime) {
        fs::File::options().write(true).open(files.blob(body)).unwrap().set_modified(last_use).unwrap();
    }

    fn exist(files: &Files, bodies: &[Hash]) -> Vec<bool> {
        bodies.iter().map(|body| files.blob(body).exists()).collect()
    }

    const DAY: Duration = Duration::from_secs(24 * 3600);

    #[test]
    fn least_recently_used_go_first_and_the_newest_last() {
        type Evict = fn(&Files, &Hash, u64);
        let by_index: Evict = |files, newest, max| {
            evict_by_index(files, newest, |bytes| goal(bytes, max)).unwrap();
        };
        let by_scan: Evict = |files, newest, max| {
            evict_by_scan(files, newest, |bytes| goal(bytes, max)).unwrap();
        };
        for evict in [by_index, by_scan] {
            let folder = tempfile::tempdir().unwrap();
            let files = Files::open(folder.path()).unwrap();
            let now = SystemTime::now();
            // In the order of eviction. A time in the future tells nothing about the last use.
            let times = [now + 1000 * DAY, now - 3 * DAY, now - 2 * DAY, now - DAY, now - 4 * DAY];
            let bodies: Vec<Hash> = (0..5u8).zip(times).map(|(i, time)| write_body(&files, i, time)).collect();
            for (max_bytes, gone) in [(500, 0), (400, 2), (299, 3), (150, 4), (50, 5)] {
                evict(&files, &bodies[4], max_bytes);
                assert_eq!(exist(&files, &bodies), (0..5).map(|i| i >= gone).collect::<Vec<_>>(), "{max_bytes}");
            }
        }
    }

    fn evicted(files: &Files, newest: &Hash, max_bytes: u64) -> Evicted {
        evict(files, newest, |bytes| goal(bytes, max_bytes)).unwrap().unwrap()
    }

    /// Returns the files that the index has.
    fn indexed(files: &Files) -> Vec<FileId> {
        let ids = Index::open(files).unwrap().with_files(|indexed| Ok(indexed.ids())).unwrap();
        ids.into_iter().collect()
    }

    #[test]
    fn index_follows_what_is_written_used_and_removed() {
        let folder = tempfile::tempdir().unwrap();
        let files = Files::open(folder.path()).unwrap();
        let now = SystemTime::now();
        let mut bodies: Vec<Hash> =
            (0..4u8).map(|i| write_body(&files, i, now - 10 * DAY + u32::from(i) * DAY)).collect();
        assert_eq!(evicted(&files, &bodies[3], 1000), Evicted { bytes_left: 400, bodies: 0 });
        // The oldest is used, another one removed, and another process writes two.
        use_body(&files, &bodies[0], now);
        fs::remove_file(files.blob(&bodies[2])).unwrap();
        changes::append(&files, &[FileId::blob(bodies[2])]).unwrap();
        bodies.extend((4..6u8).map(|i| write_body(&files, i, now - 2 * DAY)));
        changes::append(&files, &[FileId::blob(bodies[4]), FileId::blob(bodies[5])]).unwrap();
        assert_eq!(evicted(&files, &bodies[3], 1000), Evicted { bytes_left: 500, bodies: 0 });
        assert_eq!(evicted(&files, &bodies[3], 440), Evicted { bytes_left: 300, bodies: 2 });
        assert!(files.blob(&bodies[0]).exists(), "it was used since the index saw it");
        assert!(!files.blob(&bodies[1]).exists() && files.blob(&bodies[3]).exists());
        // A file that is gone without notice is found missing.
        fs::remove_file(files.blob(&bodies[0])).unwrap();
        evicted(&files, &bodies[3], 90);
        assert_eq!((exist(&files, &bodies), indexed(&files)), (vec![false; 6], Vec::new()));
        assert!(fs::read_dir(folder.path().join("changes")).unwrap().next().is_none(), "all lists are taken up");
    }

    /// Bodies are the truth: whatever becomes of the index, the least recently used ones are evicted.
    #[test]
    fn missing_or_broken_index_is_rebuilt() {
        let whole = {
            let folder = tempfile::tempdir().unwrap();
            let files = Files::open(folder.path()).unwrap();
            evicted(&files, &write_body(&files, 0, SystemTime::now() - 2 * DAY), 1000);
            fs::read(folder.path().join("index.redb")).unwrap()
        };
        let mut odd = vec![Vec::new(), b"not an index".to_vec(), vec![0; 8192], whole[..5000].to_vec()];
        for at in [0, 9, 40, 100, 300, 4096, 4200, 8192, 12_300] {
            let mut damaged = whole.clone();
            let end = damaged.len().min(at + 64);
            damaged[at..end].iter_mut().for_each(|byte| *byte ^= 0x5a);
            odd.push(damaged);
        }
        for (case, index) in odd.into_iter().enumerate() {
            let folder = tempfile::tempdir().unwrap();
            let files = Files::open(folder.path()).unwrap();
            let now = SystemTime::now();
            let bodies: Vec<Hash> =
                (0..4u8).map(|i| write_body(&files, i, now - DAY + u32::from(i) * DAY / 10)).collect();
            let is_damaged = case > 3;
            if is_damaged {
                // The index of another cache has only the first body.
                bodies[1..].iter().for_each(|body| changes::append(&files, &[FileId::blob(*body)]).unwrap());
            }
            fs::write(folder.path().join("index.redb"), index).unwrap();
            assert_eq!(evicted(&files, &bodies[3], 250), Evicted { bytes_left: 200, bodies: 2 }, "case {case}");
            assert_eq!(exist(&files, &bodies), [false, false, true, true], "case {case}");
            assert_eq!(indexed(&files).len(), 2, "case {case}");
        }
    }

    /// Measures evictions of 1,000 of a million entries: docs/decisions/0038-the-cache-has-an-index.md.
    #[test]
    #[ignore = "writes two million files"]
    fn eviction_from_a_million_entries() {
        const ENTRIES: u32 = 1_000_000;
        let folder = tempfile::tempdir_in(std::env::var_os("TERRANE_LARGE_FOLDER").unwrap_or(".".into())).unwrap();
        let files = Files::open(folder.path()).unwrap();
        let start = SystemTime::now() - 100 * DAY;
        for i in 0..ENTRIES {
            for (path, size) in
                [(files.key(&hash(&i.to_le_bytes())), 300), (files.blob(&hash(&i.to_be_bytes())), 10_000)]
            {
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                let file = fs::File::create(path).unwrap();
                // The files have no blocks.
                file.set_len(size).unwrap();
                file.set_modified(start + i * Duration::from_secs(1)).unwrap();
            }
        }
        let newest = hash(&(ENTRIES - 1).to_be_bytes());
        let without_1000 = |bytes: u64| bytes - 1000 * 10_300;
        let timed = |what: &str, evict: &dyn Fn() -> Evicted| {
            let begun = Instant::now();
            let evicted = evict();
            println!("{what}: {:.1} ms, {} bodies", begun.elapsed().as_secs_f64() * 1e3, evicted.bodies);
        };
        for _ in 0..3 {
            timed("by scan", &|| evict_by_scan(&files, &newest, without_1000).unwrap());
        }
        timed("index built", &|| evict_by_index(&files, &newest, |bytes| bytes).unwrap());
        for _ in 0..5 {
            timed("by index", &|| evict_by_index(&files, &newest, without_1000).unwrap());
        }
        timed("by index, nothing to remove", &|| evict_by_index(&files, &newest, |bytes| bytes).unwrap());
        println!("index: {} MB", fs::metadata(folder.path().join("index.redb")).unwrap().len() / 1_000_000);
    }
}
