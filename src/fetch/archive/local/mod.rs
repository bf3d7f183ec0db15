//! Archives in local files. Blocking; called on the pager's file threads.

mod packed;
mod pmtiles;
mod span;
mod zip;

use std::path::Path;

use crate::fetch::archive_names::{is_packed, is_pmtiles};
use crate::fetch::{IoError, Limits};
use packed::LocalPacked;
use pmtiles::LocalPmtiles;
use zip::LocalZip;

/// An open archive file of any kind.
#[derive(Debug)]
pub(crate) enum LocalArchive {
    Zip(LocalZip),
    Pmtiles(LocalPmtiles),
    Packed(LocalPacked),
}

impl LocalArchive {
    /// Opens an archive and reads its directory or index.
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, IoError> {
        if path.to_str().is_some_and(is_pmtiles) {
            return LocalPmtiles::open(path, limits).map(Self::Pmtiles);
        }
        if path.to_str().is_some_and(is_packed) {
            return LocalPacked::open(path, limits).map(Self::Packed);
        }
        LocalZip::open(path, limits).map(Self::Zip)
    }

    /// Returns the bytes of memory that its directories take.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Zip(archive) => archive.bytes(),
            Self::Pmtiles(tiles) => tiles.bytes(),
            Self::Packed(set) => set.bytes(),
        }
    }

    /// Returns false if the file has changed since it was opened.
    pub fn is_current(&self) -> bool {
        match self {
            Self::Zip(archive) => archive.is_current(),
            Self::Pmtiles(tiles) => tiles.is_current(),
            Self::Packed(set) => set.is_current(),
        }
    }

    /// Reads and decompresses a member. Errors name `uri`.
    pub fn read(&self, uri: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        match self {
            Self::Zip(archive) => archive.read(uri, name, limits),
            Self::Pmtiles(tiles) => tiles.read(uri, name, limits),
            Self::Packed(set) => set.read(uri, name, limits),
        }
    }

    /// Returns the size of a member in bytes.
    pub fn size(&self, uri: &str, name: &str, limits: &Limits) -> Result<u64, IoError> {
        match self {
            Self::Zip(archive) => archive.size(uri, name, limits),
            Self::Pmtiles(tiles) => tiles.size(uri, name, limits),
            Self::Packed(set) => set.size(uri, name),
        }
    }
}
