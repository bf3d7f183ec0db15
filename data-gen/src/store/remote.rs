//! Files on servers and in object stores, read by parts. Small parts lie in pages, which are blocks of the cache as well.

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use terrane::fetch::RemoteFile;

use super::cache::{Block, BlockCache, BlockKey};
use super::servers::is_missing;
use crate::GenError;

/// The bytes of a page. Larger parts are read as they are.
const PAGE_BYTES: usize = 64 << 10;
/// The number of bytes that tell formats apart.
const MAGIC_BYTES: usize = 8;

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
    fn page(&self, index: u64) -> Result<Block, GenError> {
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
