//! A PMTiles file on disk. File threads.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use super::directory::Span;
use super::local::{inside, read};
use super::pmtiles::{
    HEAD_BYTES, KeptDirectories, MOST_DIRECTORIES, Step, TileDirectory, TileHeader, check_size, tile_id, too_deep,
};
use crate::io::{IoError, Limits};

/// A file whose head has been read. It is opened for each tile, so that it can be replaced.
#[derive(Debug)]
pub(crate) struct LocalTiles {
    path: PathBuf,
    header: TileHeader,
    root: TileDirectory,
    leaves: KeptDirectories<Arc<TileDirectory>>,
    length: u64,
    modified: Option<SystemTime>,
}

impl LocalTiles {
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, IoError> {
        let uri = path.display().to_string();
        let failed = |e: io::Error| IoError::of_file(&uri, &e);
        let metadata = std::fs::metadata(path).map_err(failed)?;
        let mut file = File::open(path).map_err(failed)?;
        let length = metadata.len();
        let head = read(&mut file, Span { offset: 0, size: length.min(HEAD_BYTES) }).map_err(failed)?;
        let header = TileHeader::read(&uri, &head)?;
        check_size(&uri, header.root, limits)?;
        let root = match header.root.of(&head, 0) {
            Some(bytes) => bytes.to_vec(),
            None => read(&mut file, inside(header.root, length)).map_err(failed)?,
        };
        let root = header.directory(&uri, root, limits)?;
        let leaves = KeptDirectories::new();
        Ok(Self { path: path.to_path_buf(), header, root, leaves, length, modified: metadata.modified().ok() })
    }

    /// Of the directories that are kept.
    pub fn bytes(&self) -> usize {
        self.root.bytes() + self.leaves.sum(|leaf| leaf.bytes())
    }

    /// The file is still the one whose head was read.
    pub fn is_current(&self) -> bool {
        let now = std::fs::metadata(&self.path);
        now.is_ok_and(|m| m.len() == self.length && m.modified().ok() == self.modified)
    }

    /// The tile of that name, decompressed. `uri` is what errors name.
    pub fn read(&self, uri: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        let span = self.place(uri, name, limits)?;
        check_size(uri, span, limits)?;
        self.header.unpack(uri, self.span(uri, span)?, limits)
    }

    /// Bytes of the tile of that name in the file.
    pub fn size(&self, uri: &str, name: &str, limits: &Limits) -> Result<u64, IoError> {
        Ok(self.place(uri, name, limits)?.size)
    }

    fn place(&self, uri: &str, name: &str, limits: &Limits) -> Result<Span, IoError> {
        let id = tile_id(name).ok_or_else(|| IoError::NotFound { uri: uri.to_owned() })?;
        let mut step = self.header.look_up(&self.root, id);
        for _ in 0..MOST_DIRECTORIES {
            match step.known(uri)? {
                Step::Directory(span) => step = self.header.look_up(&*self.leaf(uri, span, limits)?, id),
                Step::Tile(span) => return Ok(span),
                Step::Nothing | Step::Outside => break,
            }
        }
        Err(too_deep(uri))
    }

    fn leaf(&self, uri: &str, span: Span, limits: &Limits) -> Result<Arc<TileDirectory>, IoError> {
        if let Some(leaf) = self.leaves.get(span.offset) {
            return Ok(leaf);
        }
        check_size(uri, span, limits)?;
        let leaf = Arc::new(self.header.directory(uri, self.span(uri, span)?, limits)?);
        self.leaves.put(span.offset, leaf.clone());
        self.leaves.trim(|leaf| leaf.len());
        Ok(leaf)
    }

    fn span(&self, uri: &str, span: Span) -> Result<Vec<u8>, IoError> {
        let mut file = File::open(&self.path).map_err(|e| IoError::of_file(uri, &e))?;
        let bytes = read(&mut file, inside(span, self.length)).map_err(|e| IoError::of_file(uri, &e))?;
        if bytes.len() as u64 != span.size {
            return Err(IoError::invalid(uri, "the archive ends early"));
        }
        Ok(bytes)
    }
}
