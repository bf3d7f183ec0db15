//! For `terrane cache`: what is in a cache, whether it is as it was written, and emptying it.

use std::collections::HashSet;
use std::fs;
use std::io;
use std::path::Path;
use std::time::SystemTime;

use serde::Serialize;

use super::entry::{self, Entry};
use super::files;
use super::store::{DiskCache, read_at_most};
use crate::io::IoError;

/// What a cache holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CacheInfo {
    /// URIs.
    pub entries: u64,
    /// Different bodies.
    pub bodies: u64,
    /// Bytes of all files.
    pub bytes: u64,
    /// Bytes that they may have.
    pub max_bytes: u64,
    /// Entries that may be used without asking their server.
    pub fresh: u64,
}

/// What [`DiskCache::verify`] found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CacheVerified {
    /// Entries and bodies that are as they were written.
    pub whole: u64,
    /// Entries and bodies that are not; removed.
    pub broken: u64,
    /// Entries whose body is gone, and bodies that no entry names; removed.
    pub orphans: u64,
}

impl DiskCache {
    /// Looks at every entry; bodies are not read.
    pub fn info(&self) -> Result<CacheInfo, IoError> {
        let now = SystemTime::now();
        let (keys, blobs) = (self.scan("keys")?, self.scan("blobs")?);
        let entries = keys.iter().filter_map(|key| read_entry(&key.path));
        Ok(CacheInfo {
            entries: keys.len() as u64,
            bodies: blobs.len() as u64,
            bytes: keys.iter().chain(&blobs).map(|f| f.size).sum(),
            max_bytes: self.max_bytes(),
            fresh: entries.filter(|e| e.is_fresh(now)).count() as u64,
        })
    }

    /// Removes everything, and says how many bytes that were. The folder stays a cache.
    pub fn clear(&self) -> Result<u64, IoError> {
        let (mut bytes, mut left) = (0, Left::default());
        self.files.remove_left_overs().map_err(|e| self.failed(&e))?;
        for found in self.scan("keys")?.into_iter().chain(self.scan("blobs")?) {
            bytes += if left.removes(&found.path) { found.size } else { 0 };
        }
        left.end(bytes)
    }

    /// Reads everything and removes what is not as it was written. Other processes may go on meanwhile: what they write
    /// at this moment may be removed with its entry and is asked for again.
    pub fn verify(&self) -> Result<CacheVerified, IoError> {
        let (mut found, mut left) = (CacheVerified::default(), Left::default());
        let mut whole = HashSet::new();
        for blob in self.scan("blobs")? {
            match read_at_most(&blob.path, blob.size) {
                Ok(bytes) if files::hash(&bytes) == blob.hash => {
                    whole.insert(blob.hash);
                }
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                // What cannot be read is of no use either.
                Ok(_) | Err(_) => {
                    found.broken += 1;
                    left.removes(&blob.path);
                }
            }
        }
        let mut named = HashSet::new();
        for key in self.scan("keys")? {
            match read_entry(&key.path).and_then(|e| e.blob_hash()) {
                Some(blob) if whole.contains(&blob) => {
                    found.whole += 1;
                    named.insert(blob);
                }
                Some(_) => {
                    found.orphans += 1;
                    left.removes(&key.path);
                }
                None => {
                    found.broken += 1;
                    left.removes(&key.path);
                }
            }
        }
        for blob in whole.difference(&named) {
            found.orphans += 1;
            left.removes(&self.files.blob(blob));
        }
        found.whole += named.len() as u64;
        left.end(found)
    }

    fn scan(&self, part: &str) -> Result<Vec<files::Found>, IoError> {
        self.files.scan(part).map_err(|e| self.failed(&e))
    }

    fn failed(&self, error: &io::Error) -> IoError {
        IoError::of_file(&self.folder().display().to_string(), error)
    }
}

/// Files that could not be removed.
#[derive(Default)]
struct Left {
    count: u64,
    first: Option<IoError>,
}

impl Left {
    /// Removes a file, or a folder that has its name. Whether it was there and is gone.
    fn removes(&mut self, path: &Path) -> bool {
        let removed = match fs::remove_file(path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return false,
            Err(_) if path.is_dir() => fs::remove_dir_all(path),
            removed => removed,
        };
        if let Err(e) = &removed {
            self.count += 1;
            self.first.get_or_insert_with(|| IoError::of_file(&path.display().to_string(), e));
        }
        removed.is_ok()
    }

    /// What was found, where nothing is left that should be gone.
    fn end<T>(self, found: T) -> Result<T, IoError> {
        match self.first {
            None => Ok(found),
            Some(IoError::File { uri, reason, may_pass }) if self.count > 1 => {
                let others = self.count - 1;
                Err(IoError::File { uri, reason: format!("{reason} (and {others} others of the cache)"), may_pass })
            }
            Some(error) => Err(error),
        }
    }
}

fn read_entry(path: &Path) -> Option<Entry> {
    Entry::from_bytes(&read_at_most(path, entry::MOST_BYTES).ok()?)
}
