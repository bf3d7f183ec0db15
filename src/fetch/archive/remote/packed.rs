//! A packed set on a server: its header and table of pages by one request or two, each page of its index and each file by
//! another.

use std::sync::Arc;

use super::identity::RemoteIdentity;
use super::part::{MemberName, Part, PartReader, range_of};
use crate::fetch::archive::packed::{HEAD_BYTES, IndexPage, PackedDirectory, PackedHeader, check_content, key_of};
use crate::fetch::archive::pmtiles::DirectoryCache;
use crate::fetch::archive::span::Span;
use crate::fetch::http::{MAX_INLINE_BYTES, SharedRead, run_blocking};
use crate::fetch::{IoError, encoding};

/// A packed set whose header has been read.
#[derive(Debug)]
pub(super) struct RemotePacked {
    pub identity: RemoteIdentity,
    directory: PackedDirectory,
    /// Pages of the index. Several requests may wait for the same one.
    pages: DirectoryCache<Arc<SharedRead<IndexPage>>>,
    /// The first bytes, which hold the index of a small set.
    head: Vec<u8>,
}

impl RemotePacked {
    /// Reads the header and the table of pages.
    pub async fn open(reader: &PartReader<'_>) -> Result<Self, IoError> {
        let (url, limits) = (reader.url, reader.limits);
        let mut head = reader.read(&range_of(Span { offset: 0, size: HEAD_BYTES }), limits).await?;
        if head.offset != 0 {
            return Err(IoError::invalid(url, "another part of the archive than was asked for"));
        }
        let identity = RemoteIdentity::of(&head);
        let header = PackedHeader::read(url, &head.bytes, head.file_bytes, limits)?;
        let table = match header.table.slice_of(&head.bytes, 0) {
            Some(bytes) => bytes.to_vec(),
            None => identity.read(reader, header.table).await?.bytes,
        };
        let directory = PackedDirectory::read(url, header, &table, head.file_bytes)?;
        // A server without range requests has sent the whole set.
        head.bytes.truncate(HEAD_BYTES as usize);
        Ok(Self { identity, directory, pages: DirectoryCache::new(), head: head.bytes })
    }

    /// Returns the memory that the table and the cached pages take, in bytes.
    pub fn bytes(&self) -> usize {
        self.head.len() + self.directory.bytes() + self.pages.sum(|page| page.get().map_or(0, IndexPage::bytes))
    }

    /// Reads a file and checks its bytes. Returns it with the part that contained it.
    pub async fn read(
        &self,
        reader: &PartReader<'_>,
        MemberName { uri, name }: MemberName<'_>,
    ) -> Result<(Vec<u8>, Part), IoError> {
        let missing = || IoError::NotFound { uri: uri.to_owned() };
        let key = key_of(name).ok_or_else(missing)?;
        let (span, number) = self.directory.page_of(key).ok_or_else(missing)?;
        let page = self.pages.get_or_insert(span.offset, Arc::default);
        let was_read = page.is_done();
        let read = async || match span.slice_of(&self.head, 0) {
            Some(bytes) => self.directory.page(reader.url, number, bytes),
            None => self.directory.page(reader.url, number, &self.identity.read(reader, span).await?.bytes),
        };
        let found = page.get_or_read(read).await?.find(key);
        if !was_read {
            self.pages.evict(|page| page.get().map_or(0, IndexPage::len));
        }
        let entry = found.ok_or_else(missing)?;
        self.directory.check_span(uri, &entry, reader.limits)?;
        let mut part = self.identity.read(reader, entry.span).await?;
        let bytes = std::mem::take(&mut part.bytes);
        check_content(uri, &entry, &bytes)?;
        let (of, limits) = (uri.to_owned(), *reader.limits);
        let decode = move || encoding::gunzip(&of, bytes, &limits);
        let is_small = entry.span.size < MAX_INLINE_BYTES as u64;
        let bytes = if is_small { decode() } else { run_blocking(uri, decode).await? }?;
        let size = bytes.len() as u64;
        reader.claim(uri, size)?.keep(size);
        Ok((bytes, part))
    }
}
