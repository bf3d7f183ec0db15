//! An archive in a file.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::directory::{Directory, End, Member, Span, TAIL_BYTES};
use super::member::{data_of, piece_of, unpack};
use crate::io::{IoError, Limits};

/// An archive whose directory has been read. The file is opened for each member, so that it can be replaced.
#[derive(Debug)]
pub(crate) struct LocalArchive {
    path: PathBuf,
    directory: Directory,
    length: u64,
    modified: Option<SystemTime>,
}

impl LocalArchive {
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, IoError> {
        let uri = path.display().to_string();
        let failed = |e: io::Error| failed(&uri, &e);
        let metadata = std::fs::metadata(path).map_err(failed)?;
        let mut file = File::open(path).map_err(failed)?;
        let length = metadata.len();
        let start = length.saturating_sub(TAIL_BYTES);
        let tail = read(&mut file, Span { offset: start, size: length - start }).map_err(failed)?;
        let span = match End::find(&uri, &tail, start)? {
            End::Directory(span) => span,
            End::Record(span) => {
                let record = read(&mut file, inside(span, length)).map_err(failed)?;
                match End::of_record(&uri, &record, span.offset)? {
                    End::Directory(span) => span,
                    End::Record(_) => return Err(IoError::invalid(&uri, "zip archive: its end points to itself")),
                }
            }
        };
        if span.size > limits.max_file_bytes {
            let (got, limit) = (span.size, limits.max_file_bytes);
            return Err(IoError::TooLarge { uri, what: "directory of an archive", got, limit });
        }
        let bytes = read(&mut file, inside(span, length)).map_err(failed)?;
        let directory = Directory::read(&uri, bytes, span.offset, limits)?;
        Ok(Self { path: path.to_path_buf(), directory, length, modified: metadata.modified().ok() })
    }

    /// The file is still the one whose directory was read.
    pub fn is_current(&self) -> bool {
        let now = std::fs::metadata(&self.path);
        now.is_ok_and(|m| m.len() == self.length && m.modified().ok() == self.modified)
    }

    /// The file of that name, decompressed. `uri` is what errors name.
    pub fn read(&self, uri: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        let failed = |e: io::Error| failed(uri, &e);
        let member = self.find(uri, name)?;
        let span = piece_of(uri, &member, &self.directory, limits)?;
        let mut file = File::open(&self.path).map_err(failed)?;
        let mut piece = read(&mut file, span).map_err(failed)?;
        let data = data_of(uri, &member, &piece)?;
        if data.end > piece.len() as u64 {
            let whole = Span { offset: span.offset, size: data.end };
            piece = read(&mut file, inside(whole, self.directory.start())).map_err(failed)?;
        }
        let packed = piece.get(data.start as usize..data.end as usize).map(<[u8]>::to_vec);
        unpack(uri, &member, packed.ok_or_else(|| IoError::invalid(uri, "the archive ends early"))?, limits)
    }

    /// Bytes of the file of that name.
    pub fn size(&self, uri: &str, name: &str) -> Result<u64, IoError> {
        Ok(self.find(uri, name)?.size)
    }

    fn find(&self, uri: &str, name: &str) -> Result<Member, IoError> {
        self.directory.find(name).ok_or_else(|| IoError::NotFound { uri: uri.to_owned() })
    }
}

/// As much of a span as there is.
fn inside(span: Span, length: u64) -> Span {
    let offset = span.offset.min(length);
    Span { offset, size: span.size.min(length - offset) }
}

fn read(file: &mut File, span: Span) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(span.offset))?;
    let mut bytes = Vec::with_capacity(span.size as usize);
    file.take(span.size).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn failed(uri: &str, error: &io::Error) -> IoError {
    match error.kind() {
        io::ErrorKind::NotFound => IoError::NotFound { uri: uri.to_owned() },
        _ => IoError::File { uri: uri.to_owned(), reason: error.to_string() },
    }
}
