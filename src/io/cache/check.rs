//! For `terrane cache`: what is in a cache, whether it is as it was written, and emptying it.

use std::collections::HashSet;
use std::fs;
use std::io;
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
            fresh: entries.filter(|e| e.is_fresh(now)).count() as u64,
        })
    }

    /// Removes everything, and says how many bytes that were. The folder stays a cache.
    pub fn clear(&self) -> Result<u64, IoError> {
        let mut bytes = 0;
        for found in self.scan("keys")?.into_iter().chain(self.scan("blobs")?) {
            match fs::remove_file(&found.path) {
                Ok(()) => bytes += found.size,
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(self.failed(&e)),
            }
        }
        Ok(bytes)
    }

    /// Reads everything and removes what is not as it was written. Other processes may go on meanwhile: what they write
    /// at this moment may be removed with its entry and is asked for again.
    pub fn verify(&self) -> Result<CacheVerified, IoError> {
        let mut found = CacheVerified::default();
        let mut whole = HashSet::new();
        for blob in self.scan("blobs")? {
            match read_at_most(&blob.path, blob.size) {
                Ok(bytes) if files::hash(&bytes) == blob.hash => {
                    whole.insert(blob.hash);
                }
                Ok(_) => {
                    found.broken += 1;
                    self.remove(&blob.path)?;
                }
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(self.failed(&e)),
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
                    self.remove(&key.path)?;
                }
                None => {
                    found.broken += 1;
                    self.remove(&key.path)?;
                }
            }
        }
        for blob in whole.difference(&named) {
            found.orphans += 1;
            self.remove(&self.files.blob(blob))?;
        }
        found.whole += named.len() as u64;
        Ok(found)
    }

    fn scan(&self, part: &str) -> Result<Vec<files::Found>, IoError> {
        self.files.scan(part).map_err(|e| self.failed(&e))
    }

    fn remove(&self, path: &std::path::Path) -> Result<(), IoError> {
        match fs::remove_file(path) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => Err(self.failed(&e)),
            _ => Ok(()),
        }
    }

    fn failed(&self, error: &io::Error) -> IoError {
        IoError::File { uri: self.folder().display().to_string(), reason: error.to_string() }
    }
}

fn read_entry(path: &std::path::Path) -> Option<Entry> {
    Entry::from_bytes(&read_at_most(path, entry::MOST_BYTES).ok()?)
}
