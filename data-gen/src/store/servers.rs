//! [`Servers`]: the files on servers that a run has opened.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use lru::LruCache;
use rayon::prelude::*;
use terrane::fetch::{AllowedHost, HttpConfig, IoError, RemoteFile, RemoteFiles};

use crate::GenError;

/// The number of files whose first bytes and versions are kept, and of files that are missing.
const MAX_OPEN: NonZeroUsize = NonZeroUsize::new(1024).expect("1024 is not 0");

/// A file, and its number in the cache.
pub(super) type Opened = (Arc<RemoteFile>, u64);

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
    pub(super) fn open(&self, path: &Path, new_number: impl FnOnce() -> u64) -> Result<Opened, GenError> {
        let opened = self.look_up(path, new_number, |_| false)?;
        opened.ok_or_else(|| GenError::invalid(path, "not found"))
    }

    /// Opens a file, unless it is open. `None` if it cannot be opened for a reason that `is_missing` accepts.
    pub(super) fn look_up(
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

/// Returns true if a server has no such file, or does not show it. Servers without a file answer with several states, and some
/// with a page of theirs.
pub(super) fn is_missing(error: &IoError) -> bool {
    match error {
        IoError::Status { status, .. } => (400..500).contains(status) && !error.is_transient(),
        error => matches!(error, IoError::NotFound { .. } | IoError::Invalid { .. } | IoError::Markup { .. }),
    }
}
