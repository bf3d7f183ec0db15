//! A packed set in a local file.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

use super::span::{LocalFile, clipped, read_span};
use crate::fetch::archive::packed::{
    HEAD_BYTES, IndexPage, PackedDirectory, PackedEntry, PackedHeader, check_content, key_of,
};
use crate::fetch::archive::pmtiles::DirectoryCache;
use crate::fetch::archive::span::Span;
use crate::fetch::{IoError, Limits};

/// A packed set whose header has been read.
#[derive(Debug)]
pub(crate) struct LocalPacked {
    file: LocalFile,
    directory: PackedDirectory,
    pages: DirectoryCache<Arc<IndexPage>>,
}

impl LocalPacked {
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, IoError> {
        let uri = path.display().to_string();
        let failed = |e: io::Error| IoError::of_file(&uri, &e);
        let (archive_file, mut file) = LocalFile::open(path)?;
        let length = archive_file.length();
        let head = read_span(&mut file, Span { offset: 0, size: length.min(HEAD_BYTES) }).map_err(failed)?;
        let header = PackedHeader::read(&uri, &head, length, limits)?;
        let table = match header.table.slice_of(&head, 0) {
            Some(bytes) => bytes.to_vec(),
            None => read_span(&mut file, clipped(header.table, length)).map_err(failed)?,
        };
        let directory = PackedDirectory::read(&uri, header, &table, length)?;
        let pages = DirectoryCache::new();
        Ok(Self { file: archive_file, directory, pages })
    }

    /// Returns the memory that the table and the cached pages take, in bytes.
    pub fn bytes(&self) -> usize {
        self.directory.bytes() + self.pages.sum(|page| page.bytes())
    }

    /// Returns false if the file has changed since its header was read.
    pub fn is_current(&self) -> bool {
        self.file.is_current()
    }

    /// Reads a file and checks its bytes. Errors name `uri`.
    pub fn read(&self, uri: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        let mut file = self.file.reopen(uri)?;
        let entry = self.entry(uri, name, &mut file)?;
        self.directory.check_span(uri, &entry, limits)?;
        let bytes = self.read_span(uri, &mut file, entry.span)?;
        check_content(uri, &entry, &bytes)?;
        Ok(bytes)
    }

    /// Returns the stored size of a file in bytes.
    pub fn size(&self, uri: &str, name: &str) -> Result<u64, IoError> {
        let mut file = self.file.reopen(uri)?;
        Ok(self.entry(uri, name, &mut file)?.span.size)
    }

    fn entry(&self, uri: &str, name: &str, file: &mut File) -> Result<PackedEntry, IoError> {
        let missing = || IoError::NotFound { uri: uri.to_owned() };
        let key = key_of(name).ok_or_else(missing)?;
        let (span, number) = self.directory.page_of(key).ok_or_else(missing)?;
        let page = match self.pages.get(span.offset) {
            Some(page) => page,
            None => {
                let page = Arc::new(self.directory.page(uri, number, &self.read_span(uri, file, span)?)?);
                self.pages.put(span.offset, page.clone());
                self.pages.evict(|page| page.len());
                page
            }
        };
        page.find(key).ok_or_else(missing)
    }

    fn read_span(&self, uri: &str, file: &mut File, span: Span) -> Result<Vec<u8>, IoError> {
        let bytes = read_span(file, clipped(span, self.file.length())).map_err(|e| IoError::of_file(uri, &e))?;
        if bytes.len() as u64 != span.size {
            return Err(IoError::invalid(uri, "the packed set ends early"));
        }
        Ok(bytes)
    }
}
