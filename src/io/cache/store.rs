//! [`DiskCache`]: looking up and keeping.

use std::fs;
use std::io::{self, Read as _};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;

use super::entry::{self, Entry};
use super::files::{self, Files, Hash};
use super::stats::CacheStats;
use super::sweep::Room;
use crate::io::{IoError, Limits};

/// A use is written to disk at most so often.
const TOUCH_EVERY: Duration = Duration::from_secs(60);
/// Uses remembered.
const TOUCHES: NonZeroUsize = NonZeroUsize::new(1 << 14).expect("not zero");

/// Bytes of a cache that was given no limit.
const DEFAULT_BYTES: u64 = 2 << 30;

/// URIs remembered that are not to be kept.
const REFUSED: NonZeroUsize = NonZeroUsize::new(1 << 10).expect("not zero");

/// Where a cache is, and how large it may become.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CacheConfig {
    /// Empty, not there, or a cache already.
    pub folder: PathBuf,
    /// Bytes of all files together. Each further process that writes at the same time may go beyond by a sixteenth.
    /// The folder remembers it for those who say none; 2 GiB where nobody ever said.
    pub max_bytes: Option<u64>,
    /// Ask no server: what is here counts, however old, and what is not is an error.
    pub offline: bool,
}

impl CacheConfig {
    /// A cache in a folder, as large as it was.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), max_bytes: None, offline: false }
    }
}

/// A cache on disk; see the module's head. Any thread that may block; all methods take `&self`.
#[derive(Debug)]
pub struct DiskCache {
    pub(super) files: Files,
    config: CacheConfig,
    max_bytes: u64,
    pub(super) counts: Counts,
    /// When an entry was last said to be in use; taken for moments.
    touched: Mutex<LruCache<Hash, Instant>>,
    /// When URIs were forgotten: what was asked for before may still be on its way. Taken for moments.
    refused: Mutex<LruCache<Hash, Instant>>,
    /// Held while room is made.
    pub(super) room: Mutex<Room>,
    /// Which store the buckets of a scheme are in.
    places: Vec<(&'static str, String)>,
}

/// [`CacheStats`] as it is counted.
#[derive(Debug, Default)]
pub(super) struct Counts {
    pub hits: AtomicU64,
    pub revalidated: AtomicU64,
    pub misses: AtomicU64,
    pub stored: AtomicU64,
    pub too_large: AtomicU64,
    pub evicted: AtomicU64,
    pub corrupt: AtomicU64,
    pub write_errors: AtomicU64,
    pub bytes_hit: AtomicU64,
    pub bytes_stored: AtomicU64,
}

pub(super) fn add(count: &AtomicU64, more: u64) {
    count.fetch_add(more, Ordering::Relaxed);
}

/// A poisoned lock guards nothing that half a change could break.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl DiskCache {
    /// Opens a cache or begins one. A folder that holds other things is refused.
    pub fn open(config: &CacheConfig) -> Result<Self, IoError> {
        let failed = |e: io::Error| IoError::of_file(&config.folder.display().to_string(), &e);
        let files = Files::open(&config.folder).map_err(failed)?;
        let max_bytes = files.limit(config.max_bytes).unwrap_or(DEFAULT_BYTES);
        Ok(Self {
            files,
            config: config.clone(),
            max_bytes,
            counts: Counts::default(),
            touched: Mutex::new(LruCache::new(TOUCHES)),
            refused: Mutex::new(LruCache::new(REFUSED)),
            room: Mutex::new(Room::new(max_bytes)),
            places: Vec::new(),
        })
    }

    /// The same, where the objects of some schemes are those of certain stores: others may have buckets and keys of
    /// the same names.
    #[cfg(feature = "object-store")]
    pub(crate) fn with_places(self, places: Vec<(&'static str, String)>) -> Self {
        Self { places, ..self }
    }

    fn key_of(&self, uri: &str) -> Hash {
        let uri = uri.split('#').next().unwrap_or(uri);
        let scheme = uri.split_once("://").map_or("", |(scheme, _)| scheme);
        match self.places.iter().find(|(of, _)| scheme.eq_ignore_ascii_case(of)) {
            // No URI has a `#` left.
            Some((_, place)) => files::hash(format!("{uri}#{place}").as_bytes()),
            None => files::hash(uri.as_bytes()),
        }
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        &self.config.folder
    }

    /// Bytes that it may have.
    pub fn max_bytes(&self) -> u64 {
        self.max_bytes
    }

    /// No server is asked.
    pub fn is_offline(&self) -> bool {
        self.config.offline
    }

    /// Counters since it was opened.
    pub fn stats(&self) -> CacheStats {
        let c = &self.counts;
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        CacheStats {
            hits: of(&c.hits),
            revalidated: of(&c.revalidated),
            misses: of(&c.misses),
            stored: of(&c.stored),
            too_large: of(&c.too_large),
            evicted: of(&c.evicted),
            corrupt: of(&c.corrupt),
            write_errors: of(&c.write_errors),
            bytes_hit: of(&c.bytes_hit),
            bytes_stored: of(&c.bytes_stored),
        }
    }

    /// What is known of a URI.
    pub(crate) fn entry(&self, uri: &str) -> Option<Entry> {
        self.entry_at(&self.files.key(&self.key_of(uri)))
    }

    /// The body of an entry as it came; `None` where it is gone or broken.
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
                add(&self.counts.corrupt, 1);
                let _ = fs::remove_file(&blob);
                let _ = fs::remove_file(&key);
            }
            // Removed for others, or unreadable for now.
            Err(_) => {}
        }
        None
    }

    /// The entry and a body of its size are there, which counts as a use; the body is not read.
    pub(crate) fn has(&self, uri: &str) -> bool {
        let key_hash = self.key_of(uri);
        let key = self.files.key(&key_hash);
        let entry = self.entry_at(&key);
        let Some((blob, size)) = entry.and_then(|e| Some((self.files.blob(&e.blob_hash()?), e.size))) else {
            return false;
        };
        let is_there = fs::metadata(&blob).is_ok_and(|m| m.len() == size);
        if is_there {
            self.touch(key_hash, &[&key, &blob]);
        }
        is_there
    }

    fn entry_at(&self, key: &Path) -> Option<Entry> {
        let bytes = read_at_most(key, entry::MOST_BYTES).ok()?;
        let entry = Entry::from_bytes(&bytes);
        if entry.is_none() {
            add(&self.counts.corrupt, 1);
            let _ = fs::remove_file(key);
        }
        entry
    }

    /// Keeps a body that was asked for then, unless it was forgotten since. What cannot be written is counted, and said
    /// once.
    pub(crate) fn store(&self, uri: &str, mut entry: Entry, body: &[u8], asked: Instant) {
        let size = body.len() as u64;
        // One body is not worth all others.
        if size > self.max_bytes / 8 {
            add(&self.counts.too_large, 1);
            self.leave_out(uri);
            return;
        }
        let hash = files::hash(body);
        entry.blob = files::hex(&hash);
        entry.size = size;
        let blob = self.files.blob(&hash);
        let there = fs::metadata(&blob).is_ok_and(|m| m.is_file() && m.len() == size);
        let write = || {
            let written = if there { files::touch(&blob) } else { self.files.write(&blob, body) };
            written.and_then(|()| self.renew(uri, &entry))
        };
        let mut written = write();
        if written.as_ref().is_err_and(files::is_disk_full) && self.makes_room_on_disk(&hash, size) {
            written = write();
        }
        if let Err(e) = written {
            self.say(&e);
            self.leave_out(uri);
            return;
        }
        let key = self.key_of(uri);
        if lock(&self.refused).peek(&key).is_some_and(|refused| *refused >= asked) {
            self.remove_entry(&key);
            return;
        }
        add(&self.counts.stored, 1);
        add(&self.counts.bytes_stored, size);
        self.made_larger(&hash, entry.to_bytes().len() as u64 + if there { 0 } else { size });
    }

    /// Writes what is known of a URI whose body is kept.
    pub(crate) fn renew(&self, uri: &str, entry: &Entry) -> io::Result<()> {
        self.files.write(&self.files.key(&self.key_of(uri)), &entry.to_bytes())
    }

    /// The same, where a failure changes nothing but the next question.
    pub(crate) fn try_renew(&self, uri: &str, entry: &Entry) {
        if let Err(e) = self.renew(uri, entry) {
            self.say(&e);
        }
    }

    pub(super) fn say(&self, error: &io::Error) {
        if self.counts.write_errors.fetch_add(1, Ordering::Relaxed) == 0 {
            log::warn!("the cache {} cannot be written: {error}", self.config.folder.display());
        }
    }

    /// Drops what a decoder found to be no content, so that it is asked for again; also when it is only on its way here.
    pub fn forget(&self, uri: &str) {
        let key = self.key_of(uri);
        // Before looking for the file: `store` looks here after writing it, so that one of the two sees the other.
        lock(&self.refused).put(key, Instant::now());
        self.remove_entry(&key);
    }

    /// Drops what is known of a URI, of which something came that is not kept. Others may have the same body.
    pub(crate) fn leave_out(&self, uri: &str) {
        let _ = fs::remove_file(self.files.key(&self.key_of(uri)));
    }

    fn remove_entry(&self, key: &Hash) {
        let path = self.files.key(key);
        if let Some(blob) = self.entry_at(&path).and_then(|e| e.blob_hash()) {
            let _ = fs::remove_file(self.files.blob(&blob));
        }
        let _ = fs::remove_file(path);
    }

    pub(crate) fn count_hit(&self, bytes: u64, asked: bool) {
        add(if asked { &self.counts.revalidated } else { &self.counts.hits }, 1);
        add(&self.counts.bytes_hit, bytes);
    }

    pub(crate) fn count_miss(&self) {
        add(&self.counts.misses, 1);
    }

    fn touch(&self, key: Hash, paths: &[&Path]) {
        let now = Instant::now();
        let mut touched = lock(&self.touched);
        if touched.get(&key).is_some_and(|before| now.duration_since(*before) < TOUCH_EVERY) {
            return;
        }
        touched.put(key, now);
        drop(touched);
        for path in paths {
            // A cache that may only be read is one too.
            let _ = files::touch(path);
        }
    }
}

/// A file, but not more of it than one byte beyond `most`.
pub(super) fn read_at_most(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = fs::File::open(path)?;
    let mut bytes = Vec::with_capacity(most.min(file.metadata()?.len().saturating_add(1)) as usize);
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_used_often_is_said_to_be_once_in_a_while() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(&CacheConfig::new(folder.path())).unwrap();
        let (key, file) = ([7; 32], folder.path().join("used"));
        fs::write(&file, "").unwrap();
        let used = || fs::metadata(&file).unwrap().modified().unwrap();
        let long_ago = std::time::SystemTime::now() - Duration::from_secs(3600);
        let Some(lately) = Instant::now().checked_sub(TOUCH_EVERY / 2) else { return };
        let set = |at| {
            lock(&cache.touched).put(key, at);
            fs::File::options().write(true).open(&file).unwrap().set_modified(long_ago).unwrap();
        };
        set(lately);
        cache.touch(key, &[&file]);
        assert_eq!(used(), long_ago, "not again so soon");
        assert_eq!(lock(&cache.touched).get(&key), Some(&lately), "which does not put it off");
        let Some(before) = Instant::now().checked_sub(TOUCH_EVERY) else { return };
        set(before);
        cache.touch(key, &[&file]);
        assert!(used() > long_ago);
    }

    #[test]
    fn what_was_forgotten_is_not_kept_late_and_kept_when_it_comes_anew() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(&CacheConfig::new(folder.path())).unwrap();
        let uri = "http://h/a.glb";
        let store = |asked| cache.store(uri, Entry::default(), b"a body", asked);
        let asked = Instant::now();
        store(asked);
        assert!(cache.has(uri));
        cache.forget(uri);
        assert!(!cache.has(uri));
        // Another answer of that time was on its way here.
        store(asked);
        assert!(!cache.has(uri));
        std::thread::sleep(Duration::from_millis(2));
        store(Instant::now());
        assert!(cache.has(uri));
    }

    #[test]
    fn what_is_known_of_uris_counts_too() {
        let folder = tempfile::tempdir().unwrap();
        let max_bytes = 100_000;
        let cache =
            DiskCache::open(&CacheConfig { max_bytes: Some(max_bytes), ..CacheConfig::new(folder.path()) }).unwrap();
        let uri = |i: usize| format!("http://h/sea/{i}.glb");
        for i in 0..800 {
            cache.store(&uri(i), Entry { uri: uri(i), ..Entry::default() }, &[5; 1000], Instant::now());
        }
        let bytes = |part| cache.files.scan(part).unwrap().iter().map(|f| f.size).sum::<u64>();
        assert!(bytes("keys") + bytes("blobs") <= max_bytes, "{} of keys", bytes("keys"));
        assert!(bytes("keys") > max_bytes / 2 && bytes("blobs") == 1000);
        assert!(cache.has(&uri(799)) && !cache.has(&uri(0)), "the oldest go first");
    }
}
