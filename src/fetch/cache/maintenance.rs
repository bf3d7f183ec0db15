//! Inspection, verification and clearing of a cache, for `terrane cache`. Runs on the caller's thread.

use std::collections::HashSet;
use std::fs;
use std::io;
use std::path::Path;
use std::time::SystemTime;

use serde::Serialize;

use super::entry::{self, Entry};
use super::files::{self, Kind, read_at_most};
use super::store::DiskCache;
use crate::fetch::IoError;

/// Summary of a cache.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CacheInfo {
    /// Number of cached URIs.
    pub entries: u64,
    /// Number of different bodies.
    pub bodies: u64,
    /// Size of all files in bytes.
    pub bytes: u64,
    /// Size limit in bytes.
    pub max_bytes: u64,
    /// Number of entries that may be used without asking their server.
    pub fresh: u64,
}

/// The result of [`DiskCache::verify`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CacheVerified {
    /// Number of intact entries and bodies.
    pub whole: u64,
    /// Number of damaged entries and bodies, which were removed.
    pub broken: u64,
    /// Number of entries without a body and bodies without an entry, which were removed.
    pub orphans: u64,
}

impl DiskCache {
    /// Counts entries and bodies. Reads every entry, but no body.
    pub fn info(&self) -> Result<CacheInfo, IoError> {
        let now = SystemTime::now();
        let (keys, blobs) = (self.scan(Kind::Key)?, self.scan(Kind::Blob)?);
        let entries = keys.iter().filter_map(|key| read_entry(&key.path));
        Ok(CacheInfo {
            entries: keys.len() as u64,
            bodies: blobs.len() as u64,
            bytes: keys.iter().chain(&blobs).map(|f| f.size).sum(),
            max_bytes: self.max_bytes(),
            fresh: entries.filter(|e| e.is_fresh(now)).count() as u64,
        })
    }

    /// Removes everything and returns the number of bytes removed. The folder stays a cache.
    pub fn clear(&self) -> Result<u64, IoError> {
        let (mut bytes, mut removals) = (0, Removals::default());
        self.files().remove_leftovers().map_err(|e| self.failed(&e))?;
        for found in self.scan(Kind::Key)?.into_iter().chain(self.scan(Kind::Blob)?) {
            bytes += if removals.remove(&found.path) { found.size } else { 0 };
        }
        self.files().remove_index();
        removals.finish(bytes)
    }

    /// Reads everything and removes damaged files. Other processes may use the cache meanwhile; a file that they write at this
    /// moment may be removed, so that the next request asks the server.
    pub fn verify(&self) -> Result<CacheVerified, IoError> {
        let (mut found, mut removals) = (CacheVerified::default(), Removals::default());
        let mut whole = HashSet::new();
        for blob in self.scan(Kind::Blob)? {
            match read_at_most(&blob.path, blob.size) {
                Ok(bytes) if files::hash(&bytes) == blob.id.hash => {
                    whole.insert(blob.id.hash);
                }
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                // An unreadable body is useless, too.
                Ok(_) | Err(_) => {
                    found.broken += 1;
                    removals.remove(&blob.path);
                }
            }
        }
        let mut named = HashSet::new();
        for key in self.scan(Kind::Key)? {
            match read_entry(&key.path).and_then(|e| e.blob_hash()) {
                Some(blob) if whole.contains(&blob) => {
                    found.whole += 1;
                    named.insert(blob);
                }
                Some(_) => {
                    found.orphans += 1;
                    removals.remove(&key.path);
                }
                None => {
                    found.broken += 1;
                    removals.remove(&key.path);
                }
            }
        }
        for blob in whole.difference(&named) {
            found.orphans += 1;
            removals.remove(&self.files().blob(blob));
        }
        found.whole += named.len() as u64;
        self.files().remove_index();
        removals.finish(found)
    }

    fn scan(&self, kind: Kind) -> Result<Vec<files::Found>, IoError> {
        self.files().scan(kind).map_err(|e| self.failed(&e))
    }

    fn failed(&self, error: &io::Error) -> IoError {
        IoError::of_file(&self.folder().display().to_string(), error)
    }
}

/// Collects the failures to remove files.
#[derive(Default)]
struct Removals {
    failed: u64,
    first: Option<IoError>,
}

impl Removals {
    /// Removes a file, or a folder of that name. Returns true if it existed and is removed.
    fn remove(&mut self, path: &Path) -> bool {
        let removed = match fs::remove_file(path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return false,
            Err(_) if path.is_dir() => fs::remove_dir_all(path),
            removed => removed,
        };
        if let Err(e) = &removed {
            self.failed += 1;
            self.first.get_or_insert_with(|| IoError::of_file(&path.display().to_string(), e));
        }
        removed.is_ok()
    }

    /// Returns the result, or the first failure if a file could not be removed.
    fn finish<T>(self, found: T) -> Result<T, IoError> {
        match self.first {
            None => Ok(found),
            Some(IoError::File { uri, reason, may_pass }) if self.failed > 1 => {
                let others = self.failed - 1;
                Err(IoError::File { uri, reason: format!("{reason} (and {others} others of the cache)"), may_pass })
            }
            Some(error) => Err(error),
        }
    }
}

fn read_entry(path: &Path) -> Option<Entry> {
    Entry::from_bytes(&read_at_most(path, entry::MAX_BYTES).ok()?)
}
