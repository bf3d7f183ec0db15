//! Reads local files and members of local archives, and decompresses gzip. Blocking; called on the pager's file threads.

use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use super::archive::{LocalArchive, MAX_CACHED_ARCHIVES, MAX_CACHED_DIRECTORY_BYTES, evict_lru};
use super::archive_names::split_path;
use super::encoding::gunzip;
use super::error::IoError;
#[cfg(feature = "testing")]
use super::hung_reads::HungReads;
use super::limits::Limits;
use super::panic_guard::guarded;
use super::scope::RootScope;
use super::time_limit::run_within;

/// Reading a file whose name ends like this panics, so that tests can check the handling of decoder panics.
#[cfg(test)]
pub(crate) const PANICS: &str = "panics.zip/a";

/// The end of a path that means the names of what is in a folder.
const LISTING: &str = "/*";

/// Reads files and members of archives, and caches the directories of the archives. Shared by the file threads.
#[derive(Debug)]
pub struct FileReader {
    limits: Limits,
    /// Open archives by path. The file threads lock it briefly; directories are read without the lock.
    archives: Mutex<LruCache<PathBuf, Arc<LocalArchive>>>,
}

impl FileReader {
    /// Returns the limits of the reader.
    pub(crate) fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Creates a reader that applies the limits before and after decompression.
    pub fn new(limits: Limits) -> Self {
        Self { limits, archives: Mutex::new(LruCache::new(MAX_CACHED_ARCHIVES)) }
    }

    /// Reads a whole file and decompresses gzip. A path that continues after the name of an archive means a file inside it.
    /// The path `folder/*` means the names of what is in a folder, sorted, one a line, with a slash behind those of folders.
    pub fn read(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        guarded(uri, || self.read_unguarded(uri))
    }

    /// Reads a file of a set like [`Self::read`], unless a symbolic link leads out of the set's folder
    /// ([`Limits::follow_links`]). The path itself is not compared with the folder; [`resolve`](super::resolve) does that.
    pub(crate) fn read_within(&self, uri: &str, scope: &RootScope) -> Result<Vec<u8>, IoError> {
        self.check_links(uri, scope)?;
        self.read(uri)
    }

    /// Fails with [`IoError::LinkRefused`] if a path is in the folder of a scope, but a link on the way leads out of it.
    pub(super) fn check_links(&self, uri: &str, scope: &RootScope) -> Result<(), IoError> {
        let RootScope::Folder(folder) = scope else { return Ok(()) };
        if self.limits.follow_links || !Path::new(uri).starts_with(folder) {
            return Ok(());
        }
        // A member of an archive is where the archive is. A file that does not exist is reported by the read.
        let existing = Path::new(uri).ancestors().take_while(|path| path.starts_with(folder));
        let Some(target) = existing.filter_map(|path| path.canonicalize().ok()).next() else { return Ok(()) };
        let folder = folder.canonicalize().map_err(|e| IoError::of_file(uri, &e))?;
        match target.starts_with(&folder) {
            true => Ok(()),
            false => Err(IoError::LinkRefused { uri: uri.to_owned(), target, folder }),
        }
    }

    fn read_unguarded(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        #[cfg(test)]
        assert!(!uri.ends_with(PANICS), "a codec has a defect");
        #[cfg(feature = "testing")]
        HungReads::wait_for_bytes(uri);
        let limits = &self.limits;
        if let Some(folder) = uri.strip_suffix(LISTING).filter(|folder| Path::new(folder).is_dir()) {
            return list(folder, limits);
        }
        let Some(metadata) = self.metadata(uri)? else {
            let (archive, name) = self.open_archive_of(uri)?;
            let read = archive.read(uri, &name, limits).map_err(|error| match error {
                IoError::NotFound { .. } if name.to_ascii_lowercase().contains(".3tz/") => {
                    IoError::unsupported(uri, "a 3tz archive that another archive refers to; unpack the outer one")
                }
                error => error,
            })?;
            return gunzip(uri, read, limits);
        };
        let refused = |reason: &str| IoError::File { uri: uri.to_owned(), reason: reason.to_owned(), may_pass: false };
        if metadata.is_dir() {
            return Err(refused("is a folder"));
        }
        // Reading a pipe or a device may block forever.
        if !metadata.is_file() {
            return Err(refused("is not a regular file"));
        }
        limits.check_file_bytes(uri, metadata.len())?;
        let file = std::fs::File::open(uri).map_err(|e| IoError::of_file(uri, &e))?;
        let mut bytes = Vec::with_capacity(metadata.len() as usize);
        file.take(limits.max_file_bytes + 1).read_to_end(&mut bytes).map_err(|e| IoError::of_file(uri, &e))?;
        limits.check_file_bytes(uri, bytes.len() as u64)?;
        gunzip(uri, bytes, limits)
    }

    /// Returns the size in bytes of a file, or of a file inside an archive, as stored (gzip not decompressed).
    pub fn size(&self, uri: &str) -> Result<u64, IoError> {
        guarded(uri, || match self.metadata(uri)? {
            Some(metadata) => Ok(metadata.len()),
            None => {
                let (archive, name) = self.open_archive_of(uri)?;
                archive.size(uri, &name, &self.limits)
            }
        })
    }

    /// Returns `None` if the file does not exist.
    fn metadata(&self, uri: &str) -> Result<Option<std::fs::Metadata>, IoError> {
        #[cfg(feature = "testing")]
        HungReads::wait_for_metadata(Path::new(uri));
        match std::fs::metadata(uri) {
            Ok(metadata) => Ok(Some(metadata)),
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
            Err(e) => Err(IoError::of_file(uri, &e)),
        }
    }

    /// Returns the archive that contains a path, and the name inside it.
    fn open_archive_of(&self, uri: &str) -> Result<(Arc<LocalArchive>, String), IoError> {
        let (path, name) = split_path(uri).ok_or_else(|| missing(uri))?;
        let cached = self.cached().get(&path).cloned();
        if let Some(archive) = cached.filter(|archive| archive.is_current()) {
            return Ok((archive, name));
        }
        let archive = Arc::new(LocalArchive::open(&path, &self.limits)?);
        let mut cached = self.cached();
        cached.put(path, archive.clone());
        evict_lru(&mut cached, MAX_CACHED_DIRECTORY_BYTES, |archive| archive.bytes());
        Ok((archive, name))
    }

    fn cached(&self) -> MutexGuard<'_, LruCache<PathBuf, Arc<LocalArchive>>> {
        self.archives.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the error for a file that does not exist. A folder whose set is missing says which files would make it one.
fn missing(uri: &str) -> IoError {
    match uri.strip_suffix("/tileset.json") {
        Some(folder) if Path::new(folder).is_dir() => IoError::File {
            uri: folder.to_owned(),
            reason: "the folder has no tileset.json, layer.json or metadata.xml".to_owned(),
            may_pass: false,
        },
        _ => IoError::NotFound { uri: uri.to_owned() },
    }
}

/// Returns the names of what is in a folder. Names that are not UTF-8 are left out.
fn list(folder: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
    let failed = |e: std::io::Error| IoError::of_file(folder, &e);
    let (mut names, mut size) = (Vec::new(), 0);
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let Ok(mut name) = entry.file_name().into_string() else { continue };
        if entry.path().is_dir() {
            name.push('/');
        }
        size += name.len() as u64 + 1;
        limits.check_file_bytes(folder, size)?;
        names.push(name);
    }
    names.sort_unstable();
    names.push(String::new());
    Ok(names.join("\n").into_bytes())
}

/// Reads one file like [`FileReader::read`]. A disk that hangs is an error after [`Limits::file_timeout`].
pub fn read_file(uri: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
    let (reader, path) = (FileReader::new(*limits), uri.to_owned());
    let read = run_within(limits.file_timeout, move || reader.read(&path));
    read.unwrap_or_else(|| Err(IoError::file_timeout(uri, limits.file_timeout)))
}
