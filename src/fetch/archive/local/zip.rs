//! A zip archive in a local file. The pager's file threads; calls block.

use std::io;
use std::path::Path;
use std::sync::OnceLock;

use super::span::{LocalFile, clipped, read_span};
use crate::fetch::archive::span::Span;
use crate::fetch::archive::zip::{
    DAMAGED_NAMES, DirectoryEnd, MAX_HEADER_BYTES, Member, TAIL_BYTES, ZipDirectory, ZipIndex, check_member,
    content_range, local_header, member_span, unpack,
};
use crate::fetch::{IoError, Limits};

/// A zip archive whose directory or index has been read.
#[derive(Debug)]
pub(crate) struct LocalZip {
    file: LocalFile,
    /// The span of the directory. Members lie before it.
    directory_span: Span,
    index: Option<ZipIndex>,
    /// Read if there is no index, or if the index does not lead to a file. Several threads may read it at the same time.
    directory: OnceLock<ZipDirectory>,
}

impl LocalZip {
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, IoError> {
        let uri = path.display().to_string();
        let failed = |e: io::Error| IoError::of_file(&uri, &e);
        let (archive_file, mut file) = LocalFile::open(path)?;
        let length = archive_file.length();
        let start = length.saturating_sub(TAIL_BYTES);
        let tail = read_span(&mut file, Span { offset: start, size: length - start }).map_err(failed)?;
        let (directory_span, files) = match DirectoryEnd::find(&uri, &tail, start)? {
            DirectoryEnd::Directory(directory_span, files) => (directory_span, files),
            DirectoryEnd::Record(span) => {
                let record = read_span(&mut file, clipped(span, length)).map_err(failed)?;
                match DirectoryEnd::of_record(&uri, &record, span.offset)? {
                    DirectoryEnd::Directory(directory_span, files) => (directory_span, files),
                    DirectoryEnd::Record(_) => {
                        return Err(IoError::invalid(&uri, "zip archive: its end points to itself"));
                    }
                }
            }
        };
        let mut archive = Self { file: archive_file, directory_span, index: None, directory: OnceLock::new() };
        if let Some(bytes) = directory_span.slice_of(&tail, start) {
            let _ = archive.directory.set(ZipDirectory::read(&uri, bytes.to_vec(), directory_span.offset, limits)?);
        }
        let header = ZipIndex::find_header(&tail, start, directory_span);
        if let Some((header, piece)) =
            header.and_then(|header| Some((header, ZipIndex::span(&header, directory_span)?)))
            && piece.size <= limits.max_file_bytes
            && files <= limits.max_elements as u64
        {
            let piece = read_span(&mut file, piece).map_err(failed)?;
            archive.index = ZipIndex::read(&header, &piece, directory_span, files);
        }
        if archive.index.is_none() {
            archive.directory(&uri, limits)?;
        }
        Ok(archive)
    }

    /// Returns the memory that index and directory take, in bytes.
    pub fn bytes(&self) -> usize {
        self.directory.get().map_or(0, ZipDirectory::bytes) + self.index.as_ref().map_or(0, ZipIndex::bytes)
    }

    /// Returns false if the file has changed since its directory was read.
    pub fn is_current(&self) -> bool {
        self.file.is_current()
    }

    /// Reads and decompresses a member. Errors name `uri`.
    pub fn read(&self, uri: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        let (member, piece) = match self.read_by_index(uri, name, limits)? {
            Some(found) => found,
            None => self.read_by_directory(uri, name, limits)?,
        };
        let data = content_range(uri, &member, &piece)?;
        let packed = piece.get(data.start as usize..data.end as usize).map(<[u8]>::to_vec);
        unpack(uri, &member, packed.ok_or_else(|| IoError::invalid(uri, "the archive ends early"))?, limits)
    }

    /// Returns the size of a member in bytes.
    pub fn size(&self, uri: &str, name: &str, limits: &Limits) -> Result<u64, IoError> {
        Ok(self.find(uri, name, limits)?.size)
    }

    /// Reads header and content of a file by the index. Returns `None` if it must be looked up in the directory.
    fn read_by_index(&self, uri: &str, name: &str, limits: &Limits) -> Result<Option<(Member, Vec<u8>)>, IoError> {
        let index = self.index.as_ref().filter(|_| self.directory.get().is_none());
        let span = index.and_then(|index| index.find(name));
        let Some(span) = span.filter(|s| s.size <= limits.max_file_bytes.saturating_add(MAX_HEADER_BYTES)) else {
            return Ok(None);
        };
        let mut file = self.file.reopen(uri)?;
        let piece = read_span(&mut file, span).map_err(|e| IoError::of_file(uri, &e))?;
        let Some(member) = local_header(&piece, span.offset, name) else { return Ok(None) };
        check_member(uri, &member, limits)?;
        Ok(Some((member, piece)))
    }

    fn read_by_directory(&self, uri: &str, name: &str, limits: &Limits) -> Result<(Member, Vec<u8>), IoError> {
        let member = self.find(uri, name, limits)?;
        let span = member_span(uri, &member, self.directory_span.offset, limits)?;
        let mut file = self.file.reopen(uri)?;
        let mut piece = read_span(&mut file, span).map_err(|e| IoError::of_file(uri, &e))?;
        let data = content_range(uri, &member, &piece)?;
        if data.end > piece.len() as u64 {
            let whole = Span { offset: span.offset, size: data.end };
            piece = read_span(&mut file, clipped(whole, self.directory_span.offset))
                .map_err(|e| IoError::of_file(uri, &e))?;
        }
        Ok((member, piece))
    }

    fn find(&self, uri: &str, name: &str, limits: &Limits) -> Result<Member, IoError> {
        let directory = self.directory(uri, limits)?;
        directory.find(name).ok_or_else(|| match &self.index {
            // The name in the directory is damaged: the index has a checksum, the directory has none.
            Some(index) if index.has(name) => IoError::invalid(uri, DAMAGED_NAMES),
            _ => IoError::NotFound { uri: uri.to_owned() },
        })
    }

    fn directory(&self, uri: &str, limits: &Limits) -> Result<&ZipDirectory, IoError> {
        if let Some(directory) = self.directory.get() {
            return Ok(directory);
        }
        if self.directory_span.size > limits.max_file_bytes {
            let (got, limit) = (self.directory_span.size, limits.max_file_bytes);
            return Err(IoError::TooLarge { uri: uri.to_owned(), what: "directory of an archive", got, limit });
        }
        let mut file = self.file.reopen(uri)?;
        let bytes = read_span(&mut file, clipped(self.directory_span, self.file.length()))
            .map_err(|e| IoError::of_file(uri, &e))?;
        let directory = ZipDirectory::read(uri, bytes, self.directory_span.offset, limits)?;
        Ok(self.directory.get_or_init(|| directory))
    }
}
