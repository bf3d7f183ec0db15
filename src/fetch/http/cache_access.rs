//! [`HttpCache`]: the disk cache as the HTTP thread uses it. Reads run on blocking threads, writes after the answer, and
//! neither waits for a disk that hangs.

use std::sync::Arc;
use std::time::{Instant, SystemTime};

use reqwest::header::{ETAG, HeaderMap, HeaderName, LAST_MODIFIED};
use tokio::sync::Semaphore;

use super::blocking::DiskWork;
use super::body::{HttpBody, decode_claimed};
use crate::fetch::cache::Entry;
use crate::fetch::{ByteBudget, DiskCache, IoError, Limits, Permit};

/// The maximum number of bodies that wait to be written to disk. The next body waits until one is done.
const MAX_PENDING_WRITES: usize = 64;

/// Decides whether fresh cache entries are used without asking the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::fetch) enum CachePolicy {
    UseFresh,
    /// Asks the server about every entry, however fresh.
    AlwaysRevalidate,
}

impl CachePolicy {
    /// Returns true if an entry may be used without asking its server.
    pub fn allows(self, cache: &DiskCache, entry: &Entry) -> bool {
        cache.is_offline() || (self == Self::UseFresh && entry.is_fresh(SystemTime::now()))
    }
}

/// A cached answer.
pub(super) enum Lookup {
    /// An entry that may be used without asking, with its decompressed body.
    Fresh(Entry, Vec<u8>),
    /// An entry that the server must confirm. Its body has not been read yet.
    Stale(Entry),
    Miss,
}

/// The disk cache and the queue of writes to it. Cheap to clone. While the disk hangs ([`CacheConfig::disk_timeout`]), nothing
/// is found in the cache and nothing is stored; servers are asked instead.
///
/// [`CacheConfig::disk_timeout`]: crate::fetch::CacheConfig::disk_timeout
#[derive(Clone, Debug)]
pub(in crate::fetch) struct HttpCache {
    disk: Arc<DiskCache>,
    work: DiskWork,
    /// Holds one permit for each body on its way to the disk.
    writes: Arc<Semaphore>,
}

impl HttpCache {
    pub fn new(disk: DiskCache) -> Self {
        let work = DiskWork::new(disk.disk_timeout());
        Self { disk: Arc::new(disk), work, writes: Arc::new(Semaphore::new(MAX_PENDING_WRITES)) }
    }

    pub fn disk(&self) -> &Arc<DiskCache> {
        &self.disk
    }

    /// Waits until all pending writes are done, or have exceeded the time limit of the disk.
    pub async fn flush(&self) {
        // Fails only for a closed semaphore, and this one is never closed.
        let _ = self.writes.acquire_many(MAX_PENDING_WRITES as u32).await;
    }

    /// Counts a cache hit and returns its body.
    pub fn hit(&self, entry: &Entry, bytes: Vec<u8>, asked: bool) -> HttpBody {
        self.disk.count_hit(entry.size, asked);
        let location = entry.redirected_to.as_deref().map(Arc::from);
        HttpBody { bytes, network_bytes: 0, asked, location, is_no_content: false }
    }

    /// Looks for the entry of a URI. The permit holds the bytes of its body.
    pub(super) async fn look_up(
        &self,
        uri: &str,
        policy: CachePolicy,
        limits: &Limits,
        permit: &Permit,
    ) -> Result<Lookup, IoError> {
        let (of, limits, permit) = (uri.to_owned(), *limits, permit.clone());
        let found = self.read(uri, move |disk| {
            let Some(entry) = disk.entry(&of) else { return Ok(Lookup::Miss) };
            if !policy.allows(disk, &entry) {
                return Ok(Lookup::Stale(entry));
            }
            Ok(match read_body(disk, &of, &entry, &limits, &permit)? {
                Some(bytes) => Lookup::Fresh(entry, bytes),
                None => Lookup::Miss,
            })
        });
        found.await?.unwrap_or(Ok(Lookup::Miss))
    }

    /// Reads the entry of a URI and its decompressed body, however old. The permit holds the bytes of the body.
    pub async fn load(&self, uri: &str, limits: &Limits, permit: &Permit) -> Result<Option<(Entry, Vec<u8>)>, IoError> {
        let (of, limits, permit) = (uri.to_owned(), *limits, permit.clone());
        let found = self.read(uri, move |disk| {
            let Some(entry) = disk.entry(&of) else { return Ok(None) };
            let bytes = read_body(disk, &of, &entry, &limits, &permit)?;
            Ok(bytes.map(|bytes| (entry, bytes)))
        });
        found.await?.unwrap_or(Ok(None))
    }

    /// Reads the decompressed body of an entry, whose bytes the permit holds. Returns `None` if it is missing or damaged.
    pub(super) async fn load_body(
        &self,
        uri: &str,
        entry: &Entry,
        limits: &Limits,
        permit: &Permit,
    ) -> Result<Option<Vec<u8>>, IoError> {
        let (of, entry, limits, permit) = (uri.to_owned(), entry.clone(), *limits, permit.clone());
        let found = self.read(uri, move |disk| read_body(disk, &of, &entry, &limits, &permit));
        found.await?.unwrap_or(Ok(None))
    }

    /// Returns true if the cache has a body for a URI, without reading it.
    pub async fn contains(&self, uri: &str) -> bool {
        let of = uri.to_owned();
        matches!(self.read(uri, move |disk| disk.has(&of)).await, Ok(Some(true)))
    }

    /// Reads on a blocking thread. Returns `None` if the disk hangs.
    ///
    /// # Errors
    /// [`IoError::Timeout`] if the disk hangs and no server may be asked instead.
    async fn read<T: Send + 'static>(
        &self,
        uri: &str,
        read: impl FnOnce(&DiskCache) -> T + Send + 'static,
    ) -> Result<Option<T>, IoError> {
        let disk = self.disk.clone();
        let found = self.work.run(move || read(&disk)).await;
        if found.is_none() {
            self.disk.count_bypassed();
            if self.disk.is_offline() {
                let seconds = self.work.limit().as_secs_f64();
                return Err(IoError::Timeout { uri: uri.to_owned(), phase: "reading the cache", seconds });
            }
        }
        Ok(found)
    }

    /// Stores a body. `requested_at` is the time before its request was sent. Later loads wait for the room that the body takes
    /// until it is written.
    pub async fn store(&self, uri: &str, entry: Entry, body: Vec<u8>, requested_at: Instant, budget: &ByteBudget) {
        let (of, held) = (uri.to_owned(), budget.hold(body.len() as u64));
        let write = move |disk: &DiskCache| {
            disk.store(&of, entry, &body, requested_at);
            drop(held);
        };
        self.write_behind(write).await;
    }

    /// Replaces the entry of a URI whose body stays.
    pub(super) async fn renew(&self, uri: &str, entry: Entry) {
        let of = uri.to_owned();
        self.write_behind(move |disk| disk.try_renew(&of, &entry)).await;
    }

    /// Removes the entry and the body of a URI.
    pub(super) async fn forget(&self, uri: &str) {
        let of = uri.to_owned();
        self.write_behind(move |disk| disk.forget(&of)).await;
    }

    /// Removes the entry and the body of a URI before it returns, unless the disk is slow. For threads outside of the runtime.
    pub(super) fn forget_now(&self, uri: &str) {
        let (disk, of) = (self.disk.clone(), uri.to_owned());
        if self.work.run_now(move || disk.forget(&of)).is_none() {
            self.disk.count_bypassed();
        }
    }

    /// Removes the entry of a URI, because its new answer must not be stored.
    pub async fn remove_entry(&self, uri: &str) {
        let of = uri.to_owned();
        self.write_behind(move |disk| disk.remove_entry(&of)).await;
    }

    /// Writes on a blocking thread without delaying the answer. Does nothing if the disk hangs.
    async fn write_behind(&self, write: impl FnOnce(&DiskCache) + Send + 'static) {
        let permit = match self.work.is_hung() {
            true => None,
            // Writes that hang give their permits back at the time limit.
            false => self.writes.clone().acquire_owned().await.ok(),
        };
        let Some(permit) = permit else { return self.disk.count_bypassed() };
        let (disk, work) = (self.disk.clone(), self.work.clone());
        tokio::spawn(async move {
            let on_thread = disk.clone();
            if work.run(move || write(&on_thread)).await.is_none() {
                disk.count_bypassed();
            }
            drop(permit);
        });
    }
}

/// Reads the decompressed body of an entry. A body that cannot be decompressed is removed.
///
/// # Errors
/// [`IoError::NoRoom`] if the permit has no room for it.
fn read_body(
    disk: &DiskCache,
    uri: &str,
    entry: &Entry,
    limits: &Limits,
    permit: &Permit,
) -> Result<Option<Vec<u8>>, IoError> {
    let size = entry.size.min(limits.max_file_bytes);
    let claim = permit.claim(size).map_err(|no_room| IoError::no_room(uri, no_room))?;
    let Some(body) = disk.body(uri, entry, limits) else { return Ok(None) };
    claim.keep(body.len() as u64);
    match decode_claimed(uri, body, &entry.encoding, limits, permit) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error @ IoError::NoRoom { .. }) => Err(error),
        Err(_) => {
            disk.forget(uri);
            Ok(None)
        }
    }
}

/// Copies the validators of an answer to its cache entry. Headers that are missing leave the entry's validators unchanged.
pub(in crate::fetch) fn copy_validators(entry: &mut Entry, headers: &HeaderMap) {
    let text = |name: HeaderName| headers.get(name).and_then(|v| v.to_str().ok()).map(str::to_owned);
    if let Some(etag) = text(ETAG) {
        entry.etag = Some(etag);
    }
    if let Some(date) = text(LAST_MODIFIED) {
        entry.last_modified = Some(date);
    }
}
