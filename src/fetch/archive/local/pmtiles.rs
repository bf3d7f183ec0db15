//! A PMTiles archive in a local file.

use std::io;
use std::path::Path;
use std::sync::Arc;

use super::span::{LocalFile, clipped, read_span};
use crate::fetch::archive::pmtiles::{
    DirectoryCache, HEAD_BYTES, Lookup, MAX_DIRECTORY_DEPTH, TileDirectory, TileHeader, check_span_size, tile_id,
    too_deep,
};
use crate::fetch::archive::span::Span;
use crate::fetch::{IoError, Limits};

/// A PMTiles file whose header has been read.
#[derive(Debug)]
pub(crate) struct LocalPmtiles {
    file: LocalFile,
    header: TileHeader,
    root: TileDirectory,
    leaves: DirectoryCache<Arc<TileDirectory>>,
}

impl LocalPmtiles {
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, IoError> {
        let uri = path.display().to_string();
        let failed = |e: io::Error| IoError::of_file(&uri, &e);
        let (archive_file, mut file) = LocalFile::open(path)?;
        let length = archive_file.length();
        let head = read_span(&mut file, Span { offset: 0, size: length.min(HEAD_BYTES) }).map_err(failed)?;
        let header = TileHeader::read(&uri, &head)?;
        check_span_size(&uri, header.root, limits)?;
        let root = match header.root.slice_of(&head, 0) {
            Some(bytes) => bytes.to_vec(),
            None => read_span(&mut file, clipped(header.root, length)).map_err(failed)?,
        };
        let root = header.directory(&uri, root, limits)?;
        let leaves = DirectoryCache::new();
        Ok(Self { file: archive_file, header, root, leaves })
    }

    /// Returns the memory that the cached directories take, in bytes.
    pub fn bytes(&self) -> usize {
        self.root.bytes() + self.leaves.sum(|leaf| leaf.bytes())
    }

    /// Returns false if the file has changed since its header was read.
    pub fn is_current(&self) -> bool {
        self.file.is_current()
    }

    /// Reads and decompresses a tile. Errors name `uri`.
    pub fn read(&self, uri: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        let span = self.tile_span(uri, name, limits)?;
        check_span_size(uri, span, limits)?;
        self.header.unpack(uri, self.read_span(uri, span)?, limits)
    }

    /// Returns the stored size of a tile in bytes.
    pub fn size(&self, uri: &str, name: &str, limits: &Limits) -> Result<u64, IoError> {
        Ok(self.tile_span(uri, name, limits)?.size)
    }

    fn tile_span(&self, uri: &str, name: &str, limits: &Limits) -> Result<Span, IoError> {
        let id = tile_id(name).ok_or_else(|| IoError::NotFound { uri: uri.to_owned() })?;
        let mut lookup = self.header.look_up(&self.root, id);
        for _ in 0..MAX_DIRECTORY_DEPTH {
            match lookup.found(uri)? {
                Lookup::Directory(span) => lookup = self.header.look_up(&*self.leaf(uri, span, limits)?, id),
                Lookup::Tile(span) => return Ok(span),
                Lookup::Missing | Lookup::OutOfRange => break,
            }
        }
        Err(too_deep(uri))
    }

    fn leaf(&self, uri: &str, span: Span, limits: &Limits) -> Result<Arc<TileDirectory>, IoError> {
        if let Some(leaf) = self.leaves.get(span.offset) {
            return Ok(leaf);
        }
        check_span_size(uri, span, limits)?;
        let leaf = Arc::new(self.header.directory(uri, self.read_span(uri, span)?, limits)?);
        self.leaves.put(span.offset, leaf.clone());
        self.leaves.evict(|leaf| leaf.len());
        Ok(leaf)
    }

    fn read_span(&self, uri: &str, span: Span) -> Result<Vec<u8>, IoError> {
        let mut file = self.file.reopen(uri)?;
        let bytes = read_span(&mut file, clipped(span, self.file.length())).map_err(|e| IoError::of_file(uri, &e))?;
        if bytes.len() as u64 != span.size {
            return Err(IoError::invalid(uri, "the archive ends early"));
        }
        Ok(bytes)
    }
}
