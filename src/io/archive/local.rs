//! An archive in a file.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::SystemTime;

use super::directory::{DAMAGED, Directory, End, Member, Span, TAIL_BYTES};
use super::index::{Index, own_header};
use super::member::{SLACK_BYTES, check, data_of, piece_of, unpack};
use crate::io::{IoError, Limits};

/// An archive whose directory or index has been read. The file is opened for each member, so that it can be replaced.
#[derive(Debug)]
pub(crate) struct LocalArchive {
    path: PathBuf,
    /// Where the directory is. Members lie before it.
    place: Span,
    index: Option<Index>,
    /// Read when there is no index, or when what it says is not enough. Several threads may read it at once.
    directory: OnceLock<Directory>,
    length: u64,
    modified: Option<SystemTime>,
}

impl LocalArchive {
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, IoError> {
        let uri = path.display().to_string();
        let failed = |e: io::Error| IoError::of_file(&uri, &e);
        let metadata = std::fs::metadata(path).map_err(failed)?;
        let mut file = File::open(path).map_err(failed)?;
        let length = metadata.len();
        let start = length.saturating_sub(TAIL_BYTES);
        let tail = read(&mut file, Span { offset: start, size: length - start }).map_err(failed)?;
        let (place, files) = match End::find(&uri, &tail, start)? {
            End::Directory(place, files) => (place, files),
            End::Record(span) => {
                let record = read(&mut file, inside(span, length)).map_err(failed)?;
                match End::of_record(&uri, &record, span.offset)? {
                    End::Directory(place, files) => (place, files),
                    End::Record(_) => return Err(IoError::invalid(&uri, "zip archive: its end points to itself")),
                }
            }
        };
        let modified = metadata.modified().ok();
        let mut archive =
            Self { path: path.to_path_buf(), place, index: None, directory: OnceLock::new(), length, modified };
        if let Some(bytes) = place.of(&tail, start) {
            let _ = archive.directory.set(Directory::read(&uri, bytes.to_vec(), place.offset, limits)?);
        }
        let own = Index::place(&tail, start, place);
        if let Some((own, piece)) = own.and_then(|own| Some((own, Index::piece(&own, place)?)))
            && piece.size <= limits.max_file_bytes
            && files <= limits.max_elements as u64
        {
            let piece = read(&mut file, piece).map_err(failed)?;
            archive.index = Index::read(&own, &piece, place, files);
        }
        if archive.index.is_none() {
            archive.directory(&uri, limits)?;
        }
        Ok(archive)
    }

    /// Of index and directory, as far as they were read.
    pub fn bytes(&self) -> usize {
        self.directory.get().map_or(0, Directory::bytes) + self.index.as_ref().map_or(0, Index::bytes)
    }

    /// The file is still the one whose directory was read.
    pub fn is_current(&self) -> bool {
        let now = std::fs::metadata(&self.path);
        now.is_ok_and(|m| m.len() == self.length && m.modified().ok() == self.modified)
    }

    /// The file of that name, decompressed. `uri` is what errors name.
    pub fn read(&self, uri: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        let (member, piece) = match self.by_index(uri, name, limits)? {
            Some(found) => found,
            None => self.by_directory(uri, name, limits)?,
        };
        let data = data_of(uri, &member, &piece)?;
        let packed = piece.get(data.start as usize..data.end as usize).map(<[u8]>::to_vec);
        unpack(uri, &member, packed.ok_or_else(|| IoError::invalid(uri, "the archive ends early"))?, limits)
    }

    /// Bytes of the file of that name.
    pub fn size(&self, uri: &str, name: &str, limits: &Limits) -> Result<u64, IoError> {
        Ok(self.find(uri, name, limits)?.size)
    }

    /// Header and content of a file; `None` where the directory has to be asked.
    fn by_index(&self, uri: &str, name: &str, limits: &Limits) -> Result<Option<(Member, Vec<u8>)>, IoError> {
        let index = self.index.as_ref().filter(|_| self.directory.get().is_none());
        let span = index.and_then(|index| index.find(name));
        let Some(span) = span.filter(|s| s.size <= limits.max_file_bytes.saturating_add((1 << 18) + SLACK_BYTES))
        else {
            return Ok(None);
        };
        let mut file = File::open(&self.path).map_err(|e| IoError::of_file(uri, &e))?;
        let piece = read(&mut file, span).map_err(|e| IoError::of_file(uri, &e))?;
        let Some(member) = own_header(&piece, span.offset, name) else { return Ok(None) };
        check(uri, &member, limits)?;
        Ok(Some((member, piece)))
    }

    fn by_directory(&self, uri: &str, name: &str, limits: &Limits) -> Result<(Member, Vec<u8>), IoError> {
        let member = self.find(uri, name, limits)?;
        let span = piece_of(uri, &member, self.place.offset, limits)?;
        let mut file = File::open(&self.path).map_err(|e| IoError::of_file(uri, &e))?;
        let mut piece = read(&mut file, span).map_err(|e| IoError::of_file(uri, &e))?;
        let data = data_of(uri, &member, &piece)?;
        if data.end > piece.len() as u64 {
            let whole = Span { offset: span.offset, size: data.end };
            piece = read(&mut file, inside(whole, self.place.offset)).map_err(|e| IoError::of_file(uri, &e))?;
        }
        Ok((member, piece))
    }

    fn find(&self, uri: &str, name: &str, limits: &Limits) -> Result<Member, IoError> {
        let directory = self.directory(uri, limits)?;
        directory.find(name).ok_or_else(|| match &self.index {
            // A name was changed: the index has a checksum, the directory none.
            Some(index) if index.has(name) => IoError::invalid(uri, DAMAGED),
            _ => IoError::NotFound { uri: uri.to_owned() },
        })
    }

    fn directory(&self, uri: &str, limits: &Limits) -> Result<&Directory, IoError> {
        if let Some(directory) = self.directory.get() {
            return Ok(directory);
        }
        if self.place.size > limits.max_file_bytes {
            let (got, limit) = (self.place.size, limits.max_file_bytes);
            return Err(IoError::TooLarge { uri: uri.to_owned(), what: "directory of an archive", got, limit });
        }
        let mut file = File::open(&self.path).map_err(|e| IoError::of_file(uri, &e))?;
        let bytes = read(&mut file, inside(self.place, self.length)).map_err(|e| IoError::of_file(uri, &e))?;
        let directory = Directory::read(uri, bytes, self.place.offset, limits)?;
        Ok(self.directory.get_or_init(|| directory))
    }
}

/// As much of a span as there is.
pub(super) fn inside(span: Span, length: u64) -> Span {
    let offset = span.offset.min(length);
    Span { offset, size: span.size.min(length - offset) }
}

pub(super) fn read(file: &mut File, span: Span) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(span.offset))?;
    let mut bytes = Vec::with_capacity(span.size as usize);
    file.take(span.size).read_to_end(&mut bytes)?;
    Ok(bytes)
}
