//! [`LocalFile`]: the file of an archive, and reading a span of it. The pager's file threads; calls block.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::fetch::IoError;
use crate::fetch::archive::span::Span;

/// An archive's file as it was when its directory was read. It is opened anew for each read, so that it can be replaced.
#[derive(Debug)]
pub(super) struct LocalFile {
    path: PathBuf,
    length: u64,
    modified: Option<SystemTime>,
}

impl LocalFile {
    /// Opens the file of an archive to read its directory. Errors name its path.
    pub fn open(path: &Path) -> Result<(Self, File), IoError> {
        let failed = |e: io::Error| IoError::of_file(&path.display().to_string(), &e);
        let metadata = std::fs::metadata(path).map_err(failed)?;
        let file = File::open(path).map_err(failed)?;
        let (length, modified) = (metadata.len(), metadata.modified().ok());
        Ok((Self { path: path.to_path_buf(), length, modified }, file))
    }

    /// Opens the file again. Errors name `uri`.
    pub fn reopen(&self, uri: &str) -> Result<File, IoError> {
        File::open(&self.path).map_err(|e| IoError::of_file(uri, &e))
    }

    /// Returns the length of the file in bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Returns false if the file has changed since its directory was read.
    pub fn is_current(&self) -> bool {
        let now = std::fs::metadata(&self.path);
        now.is_ok_and(|m| m.len() == self.length && m.modified().ok() == self.modified)
    }
}

/// Clips a span to a file of `length` bytes.
pub(super) fn clipped(span: Span, length: u64) -> Span {
    let offset = span.offset.min(length);
    Span { offset, size: span.size.min(length - offset) }
}

/// Reads a span. The result is shorter if the file ends before it.
pub(super) fn read_span(file: &mut File, span: Span) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(span.offset))?;
    let mut bytes = Vec::with_capacity(span.size as usize);
    file.take(span.size).read_to_end(&mut bytes)?;
    Ok(bytes)
}
