//! PMTiles on servers: the head by one request, each directory below it and each tile by another. HTTP
//! thread.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use super::archive::{Inside, Part, RemoteArchive, range};
use super::once::Once;
use super::{DECODED_HERE_BYTES, HttpClient, blocking};
use crate::io::archive::Span;
use crate::io::archive::pmtiles::{
    HEAD_BYTES, KeptDirectories, MOST_DIRECTORIES, Step, TileDirectory, TileHeader, check_size, tile_id, too_deep,
};
use crate::io::{IoError, Limits, file};

/// What is known of a file.
#[derive(Debug)]
pub(super) struct RemoteTiles {
    header: TileHeader,
    root: TileDirectory,
    /// Whoever needs one first reads it, the others wait for that.
    leaves: KeptDirectories<Arc<Once<TileDirectory>>>,
}

impl RemoteTiles {
    /// Bytes of the directories that are kept.
    pub fn bytes(&self) -> usize {
        self.root.bytes() + self.leaves.sum(|leaf| leaf.get().map_or(0, TileDirectory::bytes))
    }
}

impl HttpClient {
    pub(super) async fn open_tiles(
        &self,
        url: &str,
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<Arc<RemoteArchive>, IoError> {
        let first = range(Span { offset: 0, size: HEAD_BYTES });
        let head = self.part(url, &first, limits, network_bytes).await?;
        if head.offset != 0 {
            return Err(IoError::invalid(url, "another part of the archive than was asked for"));
        }
        let header = TileHeader::read(url, &head.bytes)?;
        check_size(url, header.root, limits)?;
        let root = match header.root.of(&head.bytes, 0) {
            Some(bytes) => bytes.to_vec(),
            // The format has it in what was read.
            None => return Err(IoError::invalid(url, "PMTiles: the root directory is not at the beginning")),
        };
        let root = header.directory(url, root, limits)?;
        let tiles = RemoteTiles { header, root, leaves: KeptDirectories::new() };
        Ok(Arc::new(RemoteArchive::of(&head, Inside::Tiles(tiles))))
    }

    /// A tile's bytes, decompressed, and the part that they came in.
    pub(super) async fn get_tile(
        &self,
        uri: &str,
        (url, name): (&str, &str),
        (archive, tiles): (&RemoteArchive, &RemoteTiles),
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<(Vec<u8>, Part), IoError> {
        let id = tile_id(name).ok_or_else(|| IoError::NotFound { uri: uri.to_owned() })?;
        let mut step = tiles.header.look_up(&tiles.root, id);
        for _ in 0..MOST_DIRECTORIES {
            let span = match step.known(uri)? {
                Step::Tile(span) => {
                    check_size(uri, span, limits)?;
                    let mut part = self.member_part(url, archive, span, limits, network_bytes).await?;
                    let packed = std::mem::take(&mut part.bytes);
                    let (header, of, limits) = (tiles.header, uri.to_owned(), *limits);
                    let unpack = move || {
                        let bytes = header.unpack(&of, packed, &limits)?;
                        file::gunzip(&of, bytes, &limits)
                    };
                    let is_small = span.size < DECODED_HERE_BYTES as u64;
                    let bytes = if is_small { unpack() } else { blocking(uri, unpack).await? }?;
                    return Ok((bytes, part));
                }
                Step::Directory(span) => span,
                Step::Nothing | Step::Outside => break,
            };
            check_size(uri, span, limits)?;
            let cell = tiles.leaves.get_or_insert(span.offset, Arc::default);
            let was_read = cell.is_read();
            let read = async || {
                let part = self.member_part(url, archive, span, limits, network_bytes).await?;
                let (header, of, limits) = (tiles.header, url.to_owned(), *limits);
                blocking(uri, move || header.directory(&of, part.bytes, &limits)).await?
            };
            let directory = cell.get_or_read(read).await?;
            if !was_read {
                tiles.leaves.trim(|leaf| leaf.get().map_or(0, TileDirectory::len));
            }
            step = tiles.header.look_up(directory, id);
        }
        Err(too_deep(uri))
    }
}
