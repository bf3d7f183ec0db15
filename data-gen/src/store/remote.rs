//! Files on servers and in object stores, read by parts. Small parts lie in pages, which are blocks of the cache as well.

use std::io::Read as _;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use lru::LruCache;
use rayon::prelude::*;
use terrane::fetch::{AllowedHost, HttpConfig, IoError, RemoteFile, RemoteFiles};

use super::cache::{BlockCache, BlockKey};
use crate::GenError;

/// The bytes of a page. Larger parts are read as they are.
const PAGE_BYTES: usize = 64 << 10;
/// The number of bytes that tell formats apart.
const MAGIC_BYTES: usize = 8;
/// The number of files whose first bytes and versions are kept, and of files that are missing.
const MAX_OPEN: NonZeroUsize = NonZeroUsize::new(1024).expect("1024 is not 0");

/// A file, and its number in the cache.
type Opened = (Arc<RemoteFile>, u64);

/// The client for the files on servers of a run, and the files that were opened last. All threads share it.
#[derive(Default)]
pub(crate) struct Servers {
    /// Hosts that redirects may lead to whatever their addresses are.
    allowed_hosts: Vec<AllowedHost>,
    /// Created when the first file is opened.
    client: OnceLock<Arc<RemoteFiles>>,
    /// The files by address, and `None` for those that are missing. Locked for moments only; `None` before the first one.
    open: Mutex<Option<LruCache<String, Option<Opened>>>>,
}

impl Servers {
    /// Creates the client of a run that is allowed to reach some hosts.
    pub fn new(allowed_hosts: &[AllowedHost]) -> Self {
        Self { allowed_hosts: allowed_hosts.to_vec(), ..Self::default() }
    }

    /// Returns the client. An error names the file for which it is created.
    fn client(&self, path: &Path) -> Result<&Arc<RemoteFiles>, GenError> {
        if let Some(client) = self.client.get() {
            return Ok(client);
        }
        let config = HttpConfig { allowed_hosts: self.allowed_hosts.clone(), ..HttpConfig::default() };
        let client = RemoteFiles::new(&config).map_err(|e| GenError::remote(path, &e))?;
        // Another thread may have been quicker.
        Ok(self.client.get_or_init(|| Arc::new(client)))
    }

    /// Reads the content of a file inside an archive; `None` if it is missing.
    pub fn member(&self, archive: &Path, uri: &str) -> Result<Option<Vec<u8>>, GenError> {
        match self.client(archive)?.get(uri) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(IoError::NotFound { .. }) => Ok(None),
            Err(e) => Err(GenError::remote(archive, &e)),
        }
    }

    /// Opens a file, unless it is open.
    fn open(&self, path: &Path, new_number: impl FnOnce() -> u64) -> Result<Opened, GenError> {
        let opened = self.look_up(path, new_number, |_| false)?;
        opened.ok_or_else(|| GenError::invalid(path, "not found"))
    }

    /// Opens a file, unless it is open. `None` if it cannot be opened for a reason that `is_missing` accepts.
    fn look_up(
        &self,
        path: &Path,
        new_number: impl FnOnce() -> u64,
        is_missing: impl FnOnce(&IoError) -> bool,
    ) -> Result<Option<Opened>, GenError> {
        let uri = path.to_str().ok_or_else(|| GenError::invalid(path, "an address that is not UTF-8"))?;
        let lock = || self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = lock().as_mut().and_then(|open| open.get(uri)) {
            return Ok(found.clone());
        }
        let file = match self.client(path)?.open(uri) {
            Ok(file) => Some(Arc::new(file)),
            Err(e) if is_missing(&e) => None,
            Err(e) => return Err(GenError::remote(path, &e)),
        };
        let mut open = lock();
        let open = open.get_or_insert_with(|| LruCache::new(MAX_OPEN));
        // Another thread may have been quicker.
        Ok(open.get_or_insert(uri.to_owned(), || file.map(|file| (file, new_number()))).clone())
    }
}

/// Returns the version of a file on a server at this moment, and those of files beside it that are there, with their names.
pub(crate) fn remote_versions(
    path: &Path,
    beside: &[PathBuf],
    allowed_hosts: &[AllowedHost],
) -> Result<Vec<(PathBuf, String)>, GenError> {
    let servers = Servers::new(allowed_hosts);
    let own = (path.to_owned(), servers.open(path, || 0)?.0.version());
    let beside = beside.par_iter().map(|path| {
        let found = servers.look_up(path, || 0, is_missing)?;
        Ok(found.map(|(file, _)| (path.clone(), file.version())))
    });
    let beside: Vec<Option<(PathBuf, String)>> = beside.collect::<Result<_, GenError>>()?;
    Ok(std::iter::once(own).chain(beside.into_iter().flatten()).collect())
}

/// Returns true if a server has no such file, or does not show it. Servers without a file answer with several states, and some with a
/// page of theirs.
fn is_missing(error: &IoError) -> bool {
    match error {
        IoError::Status { status, .. } => (400..500).contains(status) && !error.is_transient(),
        error => matches!(error, IoError::NotFound { .. } | IoError::Invalid { .. } | IoError::Markup { .. }),
    }
}

/// Returns true for a path that is the address of a file on a server or in an object store.
pub(crate) fn is_remote(path: &Path) -> bool {
    path.to_str().is_some_and(terrane::fetch::is_remote)
}

/// Returns the first bytes of a regular file, eight at most, or those of a file on a server.
pub(crate) fn first_bytes(path: &Path, cache: &Arc<BlockCache>) -> Result<Vec<u8>, GenError> {
    if is_remote(path) {
        let head = RemoteBytes::open(path, cache)?;
        return Ok(head.head().iter().take(MAGIC_BYTES).copied().collect());
    }
    GenError::if_not_regular(path)?;
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let mut bytes = Vec::new();
    file.take(MAGIC_BYTES as u64).read_to_end(&mut bytes).map_err(GenError::file(path))?;
    Ok(bytes)
}

/// A file on a server. Threads read parts of it at the same time.
pub(crate) struct RemoteBytes {
    path: PathBuf,
    file: Arc<RemoteFile>,
    cache: Arc<BlockCache>,
    /// Its number in the cache.
    number: u64,
}

impl RemoteBytes {
    /// Opens a file and reads its first bytes.
    pub fn open(path: &Path, cache: &Arc<BlockCache>) -> Result<Self, GenError> {
        let (file, number) = cache.servers().open(path, || cache.new_image())?;
        Ok(Self { path: path.to_owned(), file, cache: Arc::clone(cache), number })
    }

    /// Like [`Self::open`]; `None` if the server has no such file, or does not show it.
    pub fn open_if_present(path: &Path, cache: &Arc<BlockCache>) -> Result<Option<Self>, GenError> {
        let found = cache.servers().look_up(path, || cache.new_image(), is_missing)?;
        Ok(found.map(|(file, number)| Self { path: path.to_owned(), file, cache: Arc::clone(cache), number }))
    }

    /// Returns the length of the file in bytes.
    pub fn size(&self) -> u64 {
        self.file.size()
    }

    /// Returns the first bytes.
    pub fn head(&self) -> &[u8] {
        self.file.head()
    }

    /// Reads a part of the file.
    pub fn read(&self, offset: u64, size: usize) -> Result<Vec<u8>, GenError> {
        let end = offset.saturating_add(size as u64);
        if size > PAGE_BYTES || end > self.size() || end <= self.head().len() as u64 {
            return self.request(offset, size);
        }
        let mut bytes = Vec::with_capacity(size);
        while bytes.len() < size {
            let at = offset + bytes.len() as u64;
            let (index, skipped) = (at / PAGE_BYTES as u64, (at % PAGE_BYTES as u64) as usize);
            let page = self.page(index)?;
            let page = page.iter().flat_map(|word| word.to_ne_bytes()).skip(skipped);
            bytes.extend(page.take((PAGE_BYTES - skipped).min(size - bytes.len())));
        }
        Ok(bytes)
    }

    /// Returns a page. The last one ends with the file, and with zeros up to a whole word.
    fn page(&self, index: u64) -> Result<super::cache::Block, GenError> {
        let key = BlockKey { image: self.number, index };
        self.cache.block(key, || {
            let first = index * PAGE_BYTES as u64;
            let mut bytes = self.request(first, (self.size() - first).min(PAGE_BYTES as u64) as usize)?;
            bytes.resize(bytes.len().next_multiple_of(4), 0);
            Ok(bytes.as_chunks().0.iter().map(|word| u32::from_ne_bytes(*word)).collect())
        })
    }

    fn request(&self, offset: u64, size: usize) -> Result<Vec<u8>, GenError> {
        self.file.read(offset, size).map_err(|e| GenError::remote(&self.path, &e))
    }
}
