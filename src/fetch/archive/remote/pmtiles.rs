//! A PMTiles archive on a server: its header by one request, each nested directory and each tile by another.

use std::sync::Arc;

use super::identity::RemoteIdentity;
use super::part::{MemberName, Part, PartReader, range_of};
use crate::fetch::archive::pmtiles::{
    DirectoryCache, HEAD_BYTES, Lookup, MAX_DIRECTORY_DEPTH, TileDirectory, TileHeader, check_span_size, tile_id,
    too_deep,
};
use crate::fetch::archive::span::Span;
use crate::fetch::http::{MAX_INLINE_BYTES, SharedRead, run_blocking};
use crate::fetch::{IoError, encoding};

/// An archive whose header and root directory have been read.
#[derive(Debug)]
pub(super) struct RemotePmtiles {
    pub identity: RemoteIdentity,
    header: TileHeader,
    root: TileDirectory,
    /// Nested directories. Several requests may wait for the same one.
    leaves: DirectoryCache<Arc<SharedRead<TileDirectory>>>,
}

impl RemotePmtiles {
    /// Reads header and root directory.
    pub async fn open(reader: &PartReader<'_>) -> Result<Self, IoError> {
        let (url, limits) = (reader.url, reader.limits);
        let head = reader.read(&range_of(Span { offset: 0, size: HEAD_BYTES }), limits).await?;
        if head.offset != 0 {
            return Err(IoError::invalid(url, "another part of the archive than was asked for"));
        }
        let header = TileHeader::read(url, &head.bytes)?;
        check_span_size(url, header.root, limits)?;
        let root = match header.root.slice_of(&head.bytes, 0) {
            Some(bytes) => bytes.to_vec(),
            // The format requires it among the first bytes.
            None => return Err(IoError::invalid(url, "PMTiles: the root directory is not at the beginning")),
        };
        let root = header.directory(url, root, limits)?;
        Ok(Self { identity: RemoteIdentity::of(&head), header, root, leaves: DirectoryCache::new() })
    }

    /// Returns the memory that the cached directories take, in bytes.
    pub fn bytes(&self) -> usize {
        self.root.bytes() + self.leaves.sum(|leaf| leaf.get().map_or(0, TileDirectory::bytes))
    }

    /// Reads and decompresses a tile. Returns it with the part that contained it.
    pub async fn read(
        &self,
        reader: &PartReader<'_>,
        MemberName { uri, name }: MemberName<'_>,
    ) -> Result<(Vec<u8>, Part), IoError> {
        let limits = reader.limits;
        let id = tile_id(name).ok_or_else(|| IoError::NotFound { uri: uri.to_owned() })?;
        let mut lookup = self.header.look_up(&self.root, id);
        for _ in 0..MAX_DIRECTORY_DEPTH {
            let span = match lookup.found(uri)? {
                Lookup::Tile(span) => return self.read_tile(reader, uri, span).await,
                Lookup::Directory(span) => span,
                Lookup::Missing | Lookup::OutOfRange => break,
            };
            check_span_size(uri, span, limits)?;
            let leaf = self.leaves.get_or_insert(span.offset, Arc::default);
            let was_read = leaf.is_done();
            let read = async || {
                let part = self.identity.read(reader, span).await?;
                let (header, of, limits) = (self.header, reader.url.to_owned(), *limits);
                run_blocking(uri, move || header.directory(&of, part.bytes, &limits)).await?
            };
            let directory = leaf.get_or_read(read).await?;
            if !was_read {
                self.leaves.evict(|leaf| leaf.get().map_or(0, TileDirectory::len));
            }
            lookup = self.header.look_up(directory, id);
        }
        Err(too_deep(uri))
    }

    async fn read_tile(&self, reader: &PartReader<'_>, uri: &str, span: Span) -> Result<(Vec<u8>, Part), IoError> {
        check_span_size(uri, span, reader.limits)?;
        let mut part = self.identity.read(reader, span).await?;
        let packed = std::mem::take(&mut part.bytes);
        let (header, of, limits) = (self.header, uri.to_owned(), *reader.limits);
        let decode = move || {
            let bytes = header.unpack(&of, packed, &limits)?;
            encoding::gunzip(&of, bytes, &limits)
        };
        let is_small = span.size < MAX_INLINE_BYTES as u64;
        let bytes = if is_small { decode() } else { run_blocking(uri, decode).await? }?;
        let size = bytes.len() as u64;
        reader.claim(uri, size)?.keep(size);
        Ok((bytes, part))
    }
}
