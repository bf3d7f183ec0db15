//! [`RemoteArchives`]: the open archives of a client, and the disk cache for their members. Runs on the runtime of the HTTP
//! client.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime};

use lru::LruCache;

use super::identity::RemoteIdentity;
use super::packed::RemotePacked;
use super::part::{MemberName, Part, PartReader};
use super::pmtiles::RemotePmtiles;
use super::reread_limit::RereadLimit;
use super::zip::RemoteZip;
use crate::fetch::archive::{MAX_CACHED_ARCHIVES, MAX_CACHED_DIRECTORY_BYTES, evict_lru};
use crate::fetch::archive_names::{is_packed, is_pmtiles};
use crate::fetch::cache::Entry;
use crate::fetch::http::{CachePolicy, HttpBody, HttpCache, SharedRead, Transport, copy_validators};
use crate::fetch::{ByteBudget, IoError, Limits, shown};

/// A member of an archive: its URI, split into the URL of the archive and the name inside.
#[derive(Clone, Copy)]
pub(crate) struct MemberUri<'a> {
    pub uri: &'a str,
    pub archive_url: &'a str,
    pub name: &'a str,
}

/// An open archive of any kind.
#[derive(Debug)]
enum RemoteArchive {
    Zip(Box<RemoteZip>),
    Pmtiles(Box<RemotePmtiles>),
    Packed(Box<RemotePacked>),
}

impl RemoteArchive {
    async fn open(reader: &PartReader<'_>) -> Result<Arc<Self>, IoError> {
        let path = reader.url.split('?').next().unwrap_or(reader.url);
        Ok(Arc::new(if is_pmtiles(path) {
            Self::Pmtiles(Box::new(RemotePmtiles::open(reader).await?))
        } else if is_packed(path) {
            Self::Packed(Box::new(RemotePacked::open(reader).await?))
        } else {
            Self::Zip(Box::new(RemoteZip::open(reader).await?))
        }))
    }

    fn identity(&self) -> &RemoteIdentity {
        match self {
            Self::Zip(zip) => &zip.identity,
            Self::Pmtiles(tiles) => &tiles.identity,
            Self::Packed(set) => &set.identity,
        }
    }

    /// Returns the memory that its directories take, in bytes.
    fn bytes(&self) -> usize {
        match self {
            Self::Zip(zip) => zip.bytes(),
            Self::Pmtiles(tiles) => tiles.bytes(),
            Self::Packed(set) => set.bytes(),
        }
    }

    async fn read(&self, reader: &PartReader<'_>, member: MemberName<'_>) -> Result<(Vec<u8>, Part), IoError> {
        match self {
            Self::Zip(zip) => zip.read(reader, member).await,
            Self::Pmtiles(tiles) => tiles.read(reader, member).await,
            Self::Packed(set) => set.read(reader, member).await,
        }
    }
}

/// An archive that one request opens while the others wait.
type OpenArchive = Arc<SharedRead<Arc<RemoteArchive>>>;

/// The most recently used archives by URL.
#[derive(Debug)]
pub(crate) struct RemoteArchives {
    /// Locked briefly; archives are opened without the lock.
    open: Mutex<LruCache<String, OpenArchive>>,
    rereads: RereadLimit,
}

impl RemoteArchives {
    pub fn new() -> Self {
        Self { open: Mutex::new(LruCache::new(MAX_CACHED_ARCHIVES)), rereads: RereadLimit::new() }
    }

    /// Reads a member of an archive. The disk cache holds members, not archives: a valid one costs no request.
    pub async fn get(
        &self,
        transport: &Transport,
        cache: Option<&HttpCache>,
        policy: CachePolicy,
        member: MemberUri<'_>,
        limits: &Limits,
    ) -> Result<HttpBody, IoError> {
        let MemberUri { uri, archive_url, name } = member;
        let mut cached = None;
        if let Some(cache) = cache {
            cached = match cache.load(uri, limits, transport.permit()).await? {
                Some((entry, bytes)) if policy.allows(cache.disk(), &entry) => {
                    return Ok(cache.hit(&entry, bytes, false));
                }
                None if cache.disk().is_offline() => {
                    cache.disk().count_miss();
                    return Err(IoError::Offline { uri: uri.to_owned() });
                }
                cached => cached,
            };
        }
        let reader = PartReader::new(transport, archive_url, limits);
        let open = self.open(archive_url);
        let archive = open.get_or_read(async || RemoteArchive::open(&reader).await).await?;
        self.evict();
        if let (Some(cache), Some((entry, bytes))) = (cache, cached)
            && archive.identity().vouches_for(&entry, Instant::now())
        {
            let network_bytes = reader.network_bytes();
            let hit = cache.hit(&entry, bytes, true);
            return Ok(HttpBody { network_bytes, asked: network_bytes > 0, ..hit });
        }
        let read = archive.read(&reader, MemberName { uri, name }).await;
        if read.as_ref().is_err_and(IoError::is_no_content) {
            self.suspect_archive(archive_url, archive);
        }
        let (bytes, part) = read?;
        if let Some(cache) = cache {
            store(cache, uri, &part, &bytes, transport.permit().budget()).await;
        }
        let network_bytes = reader.network_bytes();
        Ok(HttpBody { bytes, network_bytes, asked: network_bytes > 0, ..HttpBody::default() })
    }

    /// Reports that a member of the archive at a URL had invalid bytes. The directory may be damaged, since it has no
    /// checksum; it is read again, at growing intervals.
    pub fn suspect(&self, url: &str) {
        let archive = self.lock().peek(url).and_then(|open| open.get()).cloned();
        if let Some(archive) = archive {
            self.suspect_archive(url, &archive);
        }
    }

    fn suspect_archive(&self, url: &str, archive: &RemoteArchive) {
        if self.rereads.allows(url, Instant::now()) {
            archive.identity().mark_stale();
        }
    }

    fn lock(&self) -> MutexGuard<'_, LruCache<String, OpenArchive>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the archive at a URL, opened or not. A stale one is replaced.
    fn open(&self, url: &str) -> OpenArchive {
        let mut archives = self.lock();
        if archives.peek(url).and_then(|open| open.get()).is_some_and(|archive| archive.identity().is_stale()) {
            archives.pop(url);
        }
        archives.get_or_insert(url.to_owned(), Arc::default).clone()
    }

    /// Removes the least recently used archives beyond the memory limit.
    fn evict(&self) {
        let bytes = |open: &OpenArchive| open.get().map_or(0, |archive| archive.bytes());
        evict_lru(&mut self.lock(), MAX_CACHED_DIRECTORY_BYTES, bytes);
    }
}

/// Stores a member in the disk cache if the headers of its part allow that.
async fn store(cache: &HttpCache, uri: &str, part: &Part, bytes: &[u8], budget: &ByteBudget) {
    cache.disk().count_miss();
    let freshness = part.freshness;
    if !freshness.store {
        return cache.remove_entry(uri).await;
    }
    let mut entry = Entry { uri: shown(uri).into_owned(), ..Entry::default() };
    entry.checked(SystemTime::now(), freshness.fresh_for);
    copy_validators(&mut entry, &part.headers);
    cache.store(uri, entry, bytes.to_vec(), part.requested_at, budget).await;
}
