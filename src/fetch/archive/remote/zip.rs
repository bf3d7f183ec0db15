//! A zip archive or 3D Tiles archive on a server. Runs on the runtime of the HTTP client.

use super::identity::RemoteIdentity;
use super::part::{MemberName, Part, PartReader, range_of};
use crate::fetch::archive::span::Span;
use crate::fetch::archive::zip::{
    DAMAGED_NAMES, DirectoryEnd, MAX_HEADER_BYTES, Member, TAIL_BYTES, ZipDirectory, ZipIndex, check_member,
    content_range, local_header, member_span, unpack,
};
use crate::fetch::http::{MAX_INLINE_BYTES, SharedRead, run_blocking};
use crate::fetch::{IoError, Limits, encoding};

/// An archive whose directory or index has been read.
#[derive(Debug)]
pub(super) struct RemoteZip {
    pub identity: RemoteIdentity,
    /// The span of the directory. Members lie before it.
    directory_span: Span,
    index: Option<ZipIndex>,
    /// Read if there is no index, or if the index does not lead to a file.
    directory: SharedRead<ZipDirectory>,
    /// Completed once the directory was received twice with the same bytes.
    confirmation: SharedRead<()>,
}

impl RemoteZip {
    /// Reads the directory or the index: with one request if the archive is small, otherwise with two or three.
    pub async fn open(reader: &PartReader<'_>) -> Result<Self, IoError> {
        let (url, limits) = (reader.url, reader.limits);
        let tail = read_tail(reader).await?;
        let identity = RemoteIdentity::of(&tail);
        let at = async |span: Span| match span.slice_of(&tail.bytes, tail.offset) {
            Some(bytes) => Ok(bytes.to_vec()),
            None => {
                let part = reader.read(&range_of(span), limits).await?;
                identity.check(url, &part, span)?;
                Ok(part.bytes)
            }
        };
        let (directory_span, files) = match DirectoryEnd::find(url, &tail.bytes, tail.offset)? {
            DirectoryEnd::Directory(span, files) => (span, files),
            DirectoryEnd::Record(span) => match DirectoryEnd::of_record(url, &at(span).await?, span.offset)? {
                DirectoryEnd::Directory(span, files) => (span, files),
                DirectoryEnd::Record(_) => return Err(IoError::invalid(url, "zip archive: its end points to itself")),
            },
        };
        let is_in_tail = directory_span.slice_of(&tail.bytes, tail.offset).is_some();
        let mut index = None;
        // If the directory is in the tail, the index is used only if it costs no request.
        if let Some(header) = ZipIndex::find_header(&tail.bytes, tail.offset, directory_span)
            && let Some(span) = ZipIndex::span(&header, directory_span)
            && (!is_in_tail || span.slice_of(&tail.bytes, tail.offset).is_some())
            && span.size <= limits.max_file_bytes
            && files <= limits.max_elements as u64
        {
            let piece = at(span).await?;
            index = run_blocking(url, move || ZipIndex::read(&header, &piece, directory_span, files)).await?;
        }
        let directory = SharedRead::default();
        if index.is_none() || is_in_tail {
            check_directory(url, directory_span, limits)?;
            let bytes = if directory_span.size == 0 { Vec::new() } else { at(directory_span).await? };
            // No other request knows this archive yet.
            directory.get_or_read(async || parse_directory(url, bytes, directory_span, limits).await).await?;
        }
        Ok(Self { identity, directory_span, index, directory, confirmation: SharedRead::default() })
    }

    /// Returns the memory that index and directory take, in bytes.
    pub fn bytes(&self) -> usize {
        self.directory.get().map_or(0, ZipDirectory::bytes) + self.index.as_ref().map_or(0, ZipIndex::bytes)
    }

    /// Reads and decompresses a member. Returns it with the part that contained it.
    pub async fn read(&self, reader: &PartReader<'_>, member: MemberName<'_>) -> Result<(Vec<u8>, Part), IoError> {
        let uri = member.uri;
        let (header, part) = match self.read_by_index(reader, member).await? {
            Some(found) => found,
            None => self.read_by_directory(reader, member).await?,
        };
        let content = content_range(uri, &header, &part.bytes)?;
        let packed = part.bytes.get(content.start as usize..content.end as usize).map(<[u8]>::to_vec);
        let packed = packed.ok_or_else(|| IoError::invalid(uri, "the archive ends early"))?;
        let claim = reader.claim(uri, header.size)?;
        let (of, limits) = (uri.to_owned(), *reader.limits);
        let decode = move || {
            let bytes = unpack(&of, &header, packed, &limits)?;
            encoding::gunzip(&of, bytes, &limits)
        };
        let is_small = header.size < MAX_INLINE_BYTES as u64;
        let bytes = if is_small { decode() } else { run_blocking(uri, decode).await? }?;
        claim.keep(bytes.len() as u64);
        Ok((bytes, part))
    }

    /// Reads header and content of a file by the index. Returns `None` if it must be looked up in the directory.
    async fn read_by_index(
        &self,
        reader: &PartReader<'_>,
        MemberName { uri, name }: MemberName<'_>,
    ) -> Result<Option<(Member, Part)>, IoError> {
        let limits = reader.limits;
        let index = self.index.as_ref().filter(|_| !self.directory.is_done());
        let span = index.and_then(|index| index.find(name));
        let Some(span) = span.filter(|s| s.size <= limits.max_file_bytes.saturating_add(MAX_HEADER_BYTES)) else {
            return Ok(None);
        };
        let part = self.identity.read(reader, span).await?;
        let Some(member) = local_header(&part.bytes, span.offset, name) else { return Ok(None) };
        check_member(uri, &member, limits)?;
        Ok(Some((member, part)))
    }

    async fn read_by_directory(
        &self,
        reader: &PartReader<'_>,
        MemberName { uri, name }: MemberName<'_>,
    ) -> Result<(Member, Part), IoError> {
        let read = async || {
            check_directory(reader.url, self.directory_span, reader.limits)?;
            let part = self.identity.read(reader, self.directory_span).await?;
            parse_directory(reader.url, part.bytes, self.directory_span, reader.limits).await
        };
        let directory = self.directory.get_or_read(read).await?;
        let Some(member) = directory.find(name) else {
            self.confirm_missing(reader, directory, name).await?;
            return Err(IoError::NotFound { uri: uri.to_owned() });
        };
        let span = member_span(uri, &member, self.directory_span.offset, reader.limits)?;
        let mut part = self.identity.read(reader, span).await?;
        let content = content_range(uri, &member, &part.bytes)?;
        if content.end > part.bytes.len() as u64 {
            let size = content.end.min(self.directory_span.offset - span.offset);
            part = self.identity.read(reader, Span { size, ..span }).await?;
        }
        Ok((member, part))
    }

    /// Confirms that a file is missing. A directory has no checksum, so its names may have been damaged in transfer. The
    /// index has one and decides; without an index the directory must be received twice with the same bytes.
    async fn confirm_missing(
        &self,
        reader: &PartReader<'_>,
        directory: &ZipDirectory,
        name: &str,
    ) -> Result<(), IoError> {
        let url = reader.url;
        let is_missing = match &self.index {
            Some(index) => !index.has(name),
            None if self.directory_span.size == 0 => true,
            None => {
                let read_again = async || {
                    let part = self.identity.read(reader, self.directory_span).await?;
                    let is_same = directory.was_parsed_from(&part.bytes);
                    if is_same { Ok(()) } else { Err(IoError::invalid(url, DAMAGED_NAMES)) }
                };
                match self.confirmation.get_or_read(read_again).await {
                    Err(IoError::Invalid { .. }) => false,
                    other => other.map(|()| true)?,
                }
            }
        };
        if is_missing {
            return Ok(());
        }
        self.identity.mark_stale();
        Err(IoError::invalid(url, DAMAGED_NAMES))
    }
}

/// Reads the end of an archive.
async fn read_tail(reader: &PartReader<'_>) -> Result<Part, IoError> {
    let tail_of = |file_bytes: u64| {
        let size = file_bytes.min(TAIL_BYTES);
        range_of(Span { offset: file_bytes - size, size })
    };
    let limits = reader.limits;
    match reader.read(&format!("bytes=-{TAIL_BYTES}"), limits).await {
        // Some servers (Azure's) support no range relative to the end. Any other range tells the size of the archive.
        Err(IoError::Unsupported { .. } | IoError::Status { status: 400 | 416, .. }) => {
            let file_bytes = reader.read("bytes=0-0", limits).await?.file_bytes;
            reader.read(&tail_of(file_bytes), limits).await
        }
        // Others read it as a range from the beginning.
        Ok(part) if part.offset + part.bytes.len() as u64 != part.file_bytes => {
            reader.read(&tail_of(part.file_bytes), limits).await
        }
        other => other,
    }
}

fn check_directory(url: &str, span: Span, limits: &Limits) -> Result<(), IoError> {
    if span.size > limits.max_file_bytes {
        let (got, limit) = (span.size, limits.max_file_bytes);
        return Err(IoError::TooLarge { uri: url.to_owned(), what: "directory of an archive", got, limit });
    }
    Ok(())
}

async fn parse_directory(url: &str, bytes: Vec<u8>, span: Span, limits: &Limits) -> Result<ZipDirectory, IoError> {
    let (of, limits) = (url.to_owned(), *limits);
    run_blocking(url, move || ZipDirectory::read(&of, bytes, span.offset, &limits)).await?
}
