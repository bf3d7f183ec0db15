//! [`DiskCache`]: look-up, storage and removal of entries. Any thread; calls block.

use std::fs;
use std::io;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;

use super::changes;
use super::counters::{Counters, add};
use super::entry::{self, Entry};
use super::eviction::Eviction;
use super::files::{self, FileId, Files, Hash, read_at_most};
use super::key::{Asker, CacheKeys};
use super::stats::CacheStats;
use crate::fetch::{IoError, Limits};

/// The shortest interval at which uses of an entry are written to disk.
const TOUCH_INTERVAL: Duration = Duration::from_secs(60);
/// The number of entries whose last use is remembered.
const MAX_TOUCHED: NonZeroUsize = NonZeroUsize::new(1 << 14).expect("not zero");

/// The size limit of a cache that was never given one.
const DEFAULT_BYTES: u64 = 2 << 30;

/// The time limit of one read or write by default: a disk that had stopped needs about ten seconds to start.
const DEFAULT_DISK_TIMEOUT: Duration = Duration::from_secs(15);

/// The number of remembered URIs that were discarded.
const MAX_DISCARDED: NonZeroUsize = NonZeroUsize::new(1 << 10).expect("not zero");

/// Configuration of a disk cache.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CacheConfig {
    /// The folder: an existing cache, an empty folder, or a path at which one is created.
    pub folder: PathBuf,
    /// The size limit in bytes of all entries and bodies together, without the index, which takes a few percent more. Each
    /// additional process that writes at the same time may exceed it by a sixteenth. The folder remembers the limit; `None`
    /// uses the remembered one, or 2 GiB.
    pub max_bytes: Option<u64>,
    /// Never asks a server. Cached answers are used however old they are, and a cache miss is an error.
    pub offline: bool,
    /// Time limit for one read or write. While the disk takes longer, such as a network drive whose server is gone, contents are
    /// loaded without the cache.
    pub disk_timeout: Duration,
}

impl CacheConfig {
    /// Returns a configuration for a folder with its remembered size limit.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), max_bytes: None, offline: false, disk_timeout: DEFAULT_DISK_TIMEOUT }
    }
}

/// A cache on disk, as described at its module. Called by any thread that may block.
#[derive(Debug)]
pub struct DiskCache {
    files: Files,
    config: CacheConfig,
    max_bytes: u64,
    counters: Counters,
    /// The time at which the last use of an entry was written. Locked briefly.
    touched: Mutex<LruCache<Hash, Instant>>,
    /// The time at which URIs were discarded. An answer requested before may still be in flight and must not be stored. Locked
    /// briefly.
    discarded: Mutex<LruCache<Hash, Instant>>,
    eviction: Eviction,
    keys: CacheKeys,
}

/// Locks a mutex, poisoned or not: no change under these locks can be left half done.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl DiskCache {
    /// Opens or creates a cache. Fails for a folder that contains other files.
    pub fn open(config: &CacheConfig) -> Result<Self, IoError> {
        let failed = |e: io::Error| IoError::of_file(&config.folder.display().to_string(), &e);
        let files = Files::open(&config.folder).map_err(failed)?;
        let max_bytes = files.limit(config.max_bytes).unwrap_or(DEFAULT_BYTES);
        Ok(Self {
            files,
            config: config.clone(),
            max_bytes,
            counters: Counters::default(),
            touched: Mutex::new(LruCache::new(MAX_TOUCHED)),
            discarded: Mutex::new(LruCache::new(MAX_DISCARDED)),
            eviction: Eviction::new(max_bytes),
            keys: CacheKeys::default(),
        })
    }

    /// Sets the credentials of the client that uses the cache. It finds no entry that was stored with others.
    pub(crate) fn for_asker(self, asker: Asker) -> Self {
        Self { keys: CacheKeys::new(asker), ..self }
    }

    fn key_of(&self, uri: &str) -> Hash {
        self.keys.key(&self.files, uri)
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.config.folder
    }

    /// Returns the size limit in bytes.
    pub fn max_bytes(&self) -> u64 {
        self.max_bytes
    }

    /// Returns true if no server may be asked.
    pub fn is_offline(&self) -> bool {
        self.config.offline
    }

    /// Returns the time limit for one read or write.
    pub(crate) fn disk_timeout(&self) -> Duration {
        self.config.disk_timeout
    }

    /// Returns the counters since this process opened the cache.
    pub fn stats(&self) -> CacheStats {
        self.counters.snapshot()
    }

    pub(super) fn files(&self) -> &Files {
        &self.files
    }

    /// Returns the entry of a URI.
    pub(crate) fn entry(&self, uri: &str) -> Option<Entry> {
        self.entry_at(&self.key_of(uri))
    }

    /// Reads the body of an entry as received. Returns `None` if it is missing, damaged, or larger than the limits.
    pub(crate) fn body(&self, uri: &str, entry: &Entry, limits: &Limits) -> Option<Vec<u8>> {
        let key_hash = self.key_of(uri);
        let (key, blob_hash, size) = (self.files.key(&key_hash), entry.blob_hash()?, entry.size);
        let blob = self.files.blob(&blob_hash);
        match read_at_most(&blob, size.min(limits.max_file_bytes)) {
            Ok(body) if body.len() as u64 == size && files::hash(&body) == blob_hash => {
                self.touch(key_hash, &[&key, &blob]);
                return Some(body);
            }
            Ok(_) if size > limits.max_file_bytes => {}
            Ok(_) => {
                add(&self.counters.corrupt, 1);
                self.remove_files(&[FileId::blob(blob_hash), FileId::key(key_hash)]);
            }
            // The body was evicted, or cannot be read at the moment.
            Err(_) => {}
        }
        None
    }

    /// Returns true if a URI has an entry and a body of the right size, which counts as a use. The body is not read.
    pub(crate) fn has(&self, uri: &str) -> bool {
        let key_hash = self.key_of(uri);
        let key = self.files.key(&key_hash);
        let entry = self.entry_at(&key_hash);
        let Some((blob, size)) = entry.and_then(|e| Some((self.files.blob(&e.blob_hash()?), e.size))) else {
            return false;
        };
        let is_there = fs::metadata(&blob).is_ok_and(|m| m.len() == size);
        if is_there {
            self.touch(key_hash, &[&key, &blob]);
        }
        is_there
    }

    fn entry_at(&self, key: &Hash) -> Option<Entry> {
        let bytes = read_at_most(&self.files.key(key), entry::MAX_BYTES).ok()?;
        let entry = Entry::from_bytes(&bytes);
        if entry.is_none() {
            add(&self.counters.corrupt, 1);
            self.remove_files(&[FileId::key(*key)]);
        }
        entry
    }

    /// Stores a body that was requested at `requested_at`, unless the URI was discarded since. Write errors are counted, and the
    /// first one is logged.
    pub(crate) fn store(&self, uri: &str, mut entry: Entry, body: &[u8], requested_at: Instant) {
        let size = body.len() as u64;
        // A single body must not evict all others.
        if size > self.max_bytes / 8 {
            add(&self.counters.too_large, 1);
            self.remove_entry(uri);
            return;
        }
        let hash = files::hash(body);
        entry.blob = files::hex(&hash);
        entry.size = size;
        let blob = self.files.blob(&hash);
        let is_present = fs::metadata(&blob).is_ok_and(|m| m.is_file() && m.len() == size);
        let write = || {
            let written = if is_present { files::touch(&blob) } else { self.files.write(&blob, body) };
            written.and_then(|()| self.renew(uri, &entry))
        };
        let mut written = write();
        if written.as_ref().is_err_and(files::is_disk_full) && self.frees_disk_space(&hash, size) {
            written = write();
        }
        if let Err(e) = written {
            self.report(&e);
            self.remove_entry(uri);
            return;
        }
        let key = self.key_of(uri);
        if lock(&self.discarded).peek(&key).is_some_and(|discarded| *discarded >= requested_at) {
            self.remove(&key);
            return;
        }
        add(&self.counters.stored, 1);
        add(&self.counters.bytes_stored, size);
        self.note_changes(&[FileId::key(key), FileId::blob(hash)]);
        let written = entry.to_bytes().len() as u64 + if is_present { 0 } else { size };
        match self.eviction.after_write(&self.files, &hash, written) {
            Ok(evicted) => add(&self.counters.evicted, evicted),
            Err(e) => self.report(&e),
        }
    }

    /// Evicts files on a full disk. Returns true if the write should be retried.
    fn frees_disk_space(&self, newest: &Hash, size: u64) -> bool {
        let evicted = self.eviction.on_full_disk(&self.files, newest, size);
        add(&self.counters.evicted, evicted.unwrap_or(0));
        evicted.is_some()
    }

    /// Writes the entry of a URI whose body is stored.
    fn renew(&self, uri: &str, entry: &Entry) -> io::Result<()> {
        self.files.write(&self.files.key(&self.key_of(uri)), &entry.to_bytes())
    }

    /// Writes an entry that a server confirmed. A failure only makes the next request ask the server again.
    pub(crate) fn try_renew(&self, uri: &str, entry: &Entry) {
        if let Err(e) = self.renew(uri, entry) {
            self.report(&e);
        }
    }

    /// Counts a write error and logs the first one.
    fn report(&self, error: &io::Error) {
        if self.counters.write_errors.fetch_add(1, Ordering::Relaxed) == 0 {
            log::warn!("the cache {} cannot be written: {error}", self.config.folder.display());
        }
    }

    /// Discards the body of a URI that a decoder found invalid, also while it is still in flight. The next request asks the
    /// server.
    pub fn forget(&self, uri: &str) {
        let key = self.key_of(uri);
        // Recorded before the file is removed: `store` looks here after writing it, so that one of the two sees the other.
        lock(&self.discarded).put(key, Instant::now());
        self.remove(&key);
    }

    /// Removes the entry of a URI whose new answer is not stored. The body stays, since other URIs may share it.
    pub(crate) fn remove_entry(&self, uri: &str) {
        self.remove_files(&[FileId::key(self.key_of(uri))]);
    }

    /// Removes an entry and its body.
    fn remove(&self, key: &Hash) {
        let blob = self.entry_at(key).and_then(|e| e.blob_hash());
        let files: Vec<FileId> = blob.map(FileId::blob).into_iter().chain([FileId::key(*key)]).collect();
        self.remove_files(&files);
    }

    fn remove_files(&self, ids: &[FileId]) {
        let is_removed = |id: &FileId| fs::remove_file(self.files.path(*id)).is_ok();
        let removed: Vec<FileId> = ids.iter().copied().filter(is_removed).collect();
        if !removed.is_empty() {
            self.note_changes(&removed);
        }
    }

    /// Lets the next eviction look at files that were written or removed.
    fn note_changes(&self, ids: &[FileId]) {
        if let Err(e) = changes::append(&self.files, ids) {
            // A rebuilt index has them.
            log::debug!("the cache {} cannot list its changes: {e}", self.config.folder.display());
        }
    }

    pub(crate) fn count_hit(&self, bytes: u64, asked: bool) {
        add(if asked { &self.counters.revalidated } else { &self.counters.hits }, 1);
        add(&self.counters.bytes_hit, bytes);
    }

    /// Counts a read or write that the disk did not do in time, and logs the first one.
    pub(crate) fn count_bypassed(&self) {
        if self.counters.bypassed.fetch_add(1, Ordering::Relaxed) == 0 {
            let (folder, limit_s) = (self.config.folder.display(), self.config.disk_timeout.as_secs_f64());
            log::warn!(
                "the cache {folder} does not answer within {limit_s} s; contents are loaded without it meanwhile"
            );
        }
    }

    pub(crate) fn count_miss(&self) {
        add(&self.counters.misses, 1);
    }

    /// Sets the last use of an entry's files to now, at most once per [`TOUCH_INTERVAL`].
    fn touch(&self, key: Hash, paths: &[&Path]) {
        let now = Instant::now();
        let mut touched = lock(&self.touched);
        if touched.get(&key).is_some_and(|before| now.duration_since(*before) < TOUCH_INTERVAL) {
            return;
        }
        touched.put(key, now);
        drop(touched);
        for path in paths {
            // Fails for a read-only cache, which works nevertheless.
            let _ = files::touch(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::files::Kind;
    use super::*;

    #[test]
    fn frequent_uses_are_written_once_per_interval() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(&CacheConfig::new(folder.path())).unwrap();
        let (key, file) = ([7; 32], folder.path().join("used"));
        fs::write(&file, "").unwrap();
        let used = || fs::metadata(&file).unwrap().modified().unwrap();
        let long_ago = std::time::SystemTime::now() - Duration::from_secs(3600);
        let Some(recently) = Instant::now().checked_sub(TOUCH_INTERVAL / 2) else { return };
        let set = |at| {
            lock(&cache.touched).put(key, at);
            fs::File::options().write(true).open(&file).unwrap().set_modified(long_ago).unwrap();
        };
        set(recently);
        cache.touch(key, &[&file]);
        assert_eq!(used(), long_ago, "written less than an interval ago");
        assert_eq!(lock(&cache.touched).get(&key), Some(&recently), "the time of the last write stays");
        let Some(before) = Instant::now().checked_sub(TOUCH_INTERVAL) else { return };
        set(before);
        cache.touch(key, &[&file]);
        assert!(used() > long_ago);
    }

    #[test]
    fn discarded_uris_reject_answers_in_flight_and_accept_new_ones() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(&CacheConfig::new(folder.path())).unwrap();
        let uri = "http://h/a.glb";
        let store = |requested_at| cache.store(uri, Entry::default(), b"a body", requested_at);
        let requested_at = Instant::now();
        store(requested_at);
        assert!(cache.has(uri));
        cache.forget(uri);
        assert!(!cache.has(uri));
        // Another answer, requested before, was still in flight.
        store(requested_at);
        assert!(!cache.has(uri));
        std::thread::sleep(Duration::from_millis(2));
        store(Instant::now());
        assert!(cache.has(uri));
    }

    #[test]
    fn entries_count_towards_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let max_bytes = 100_000;
        let cache =
            DiskCache::open(&CacheConfig { max_bytes: Some(max_bytes), ..CacheConfig::new(folder.path()) }).unwrap();
        let uri = |i: usize| format!("http://h/sea/{i}.glb");
        for i in 0..800 {
            cache.store(&uri(i), Entry { uri: uri(i), ..Entry::default() }, &[5; 1000], Instant::now());
        }
        let bytes = |kind| cache.files.scan(kind).unwrap().iter().map(|f| f.size).sum::<u64>();
        assert!(bytes(Kind::Key) + bytes(Kind::Blob) <= max_bytes, "{} of keys", bytes(Kind::Key));
        assert!(bytes(Kind::Key) > max_bytes / 2 && bytes(Kind::Blob) == 1000);
        assert!(cache.has(&uri(799)) && !cache.has(&uri(0)), "the oldest are removed first");
    }
}
