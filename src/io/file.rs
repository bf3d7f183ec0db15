//! Bytes from local files and archives, gzip undone by magic. Blocking; called on the pager's file threads.

use std::io::{ErrorKind, Read};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use super::archive::{KEPT_ARCHIVES, KEPT_BYTES, Local, split_path, trim};
use super::read::guarded;
use super::{IoError, Limits};

/// Files of this name end in the panic of a codec, which none is known to have.
#[cfg(test)]
pub(crate) const PANICS: &str = "panics.zip/a";

/// Reads files, and files inside archives, whose directories it keeps. Shared by the file threads.
#[derive(Debug)]
pub struct FileReader {
    limits: Limits,
    /// By path; taken for moments, a directory is read outside of it.
    archives: Mutex<LruCache<PathBuf, Arc<Local>>>,
}

impl FileReader {
    /// A reader that refuses more than the limits, before and after decompression.
    pub fn new(limits: Limits) -> Self {
        Self { limits, archives: Mutex::new(LruCache::new(KEPT_ARCHIVES)) }
    }

    /// A file whole, gzip undone. A path that goes on behind the name of an archive is a file inside it.
    pub fn read(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        guarded(uri, || self.read_unguarded(uri))
    }

    fn read_unguarded(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        #[cfg(test)]
        assert!(!uri.ends_with(PANICS), "a codec has a defect");
        let limits = &self.limits;
        let Some(metadata) = self.metadata(uri)? else {
            let (archive, name) = self.inside(uri)?;
            return gunzip(uri, archive.read(uri, &name, limits)?, limits);
        };
        let refused = |reason: &str| IoError::File { uri: uri.to_owned(), reason: reason.to_owned(), may_pass: false };
        if metadata.is_dir() {
            return Err(refused("is a folder"));
        }
        // A pipe or a device may never end, or never begin.
        if !metadata.is_file() {
            return Err(refused("is not a regular file"));
        }
        check(uri, metadata.len(), limits)?;
        let file = std::fs::File::open(uri).map_err(|e| IoError::of_file(uri, &e))?;
        let mut bytes = Vec::with_capacity(metadata.len() as usize);
        file.take(limits.max_file_bytes + 1).read_to_end(&mut bytes).map_err(|e| IoError::of_file(uri, &e))?;
        check(uri, bytes.len() as u64, limits)?;
        gunzip(uri, bytes, limits)
    }

    /// Bytes of a file, or of one inside an archive, as it is there.
    pub fn size(&self, uri: &str) -> Result<u64, IoError> {
        guarded(uri, || match self.metadata(uri)? {
            Some(metadata) => Ok(metadata.len()),
            None => {
                let (archive, name) = self.inside(uri)?;
                archive.size(uri, &name, &self.limits)
            }
        })
    }

    /// `None` where there is no such file.
    fn metadata(&self, uri: &str) -> Result<Option<std::fs::Metadata>, IoError> {
        match std::fs::metadata(uri) {
            Ok(metadata) => Ok(Some(metadata)),
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
            Err(e) => Err(IoError::of_file(uri, &e)),
        }
    }

    /// The archive that a path goes into, and the name inside it.
    fn inside(&self, uri: &str) -> Result<(Arc<Local>, String), IoError> {
        let (path, name) = split_path(uri).ok_or_else(|| IoError::NotFound { uri: uri.to_owned() })?;
        let kept = self.kept().get(&path).cloned();
        if let Some(archive) = kept.filter(|archive| archive.is_current()) {
            return Ok((archive, name));
        }
        let archive = Arc::new(Local::open(&path, &self.limits)?);
        let mut kept = self.kept();
        kept.put(path, archive.clone());
        trim(&mut kept, KEPT_BYTES, |archive| archive.bytes());
        Ok((archive, name))
    }

    fn kept(&self) -> MutexGuard<'_, LruCache<PathBuf, Arc<Local>>> {
        self.archives.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Reads one file as a [`FileReader`] does.
pub fn read_file(uri: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
    FileReader::new(*limits).read(uri)
}

/// Undoes gzip where the magic says so (servers and disks hold tiles compressed without saying it).
pub(crate) fn gunzip(uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(bytes);
    }
    let most = limits.max_file_bytes.saturating_add(1);
    let mut plain = Vec::with_capacity(most.min(bytes.len() as u64 * 3) as usize);
    flate2::read::MultiGzDecoder::new(bytes.as_slice())
        .take(most)
        .read_to_end(&mut plain)
        .map_err(|e| IoError::invalid(uri, format!("gzip: {e}")))?;
    check(uri, plain.len() as u64, limits)?;
    Ok(plain)
}

fn check(uri: &str, got: u64, limits: &Limits) -> Result<(), IoError> {
    if got > limits.max_file_bytes {
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "file", got, limit: limits.max_file_bytes });
    }
    Ok(())
}
