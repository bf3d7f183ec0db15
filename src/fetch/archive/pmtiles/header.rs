//! The header of a PMTiles file: the spans of its parts and their compression.

use super::directory::{Lookup, TileDirectory};
use crate::fetch::archive::span::{Span, le_uint};
use crate::fetch::{IoError, Limits, encoding};

/// The number of bytes that are read first. They hold the header and the root directory, which ends before them by the
/// format.
pub(crate) const HEAD_BYTES: u64 = 16 << 10;
/// The maximum depth of nested directories. The format's own writers produce two levels.
pub(in crate::fetch::archive) const MAX_DIRECTORY_DEPTH: usize = 4;

/// Compression of directories or of tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Compression {
    /// Uncompressed, or unknown.
    None,
    Gzip,
    Brotli,
    Zstd,
}

impl Compression {
    fn from_code(code: u64) -> Option<Self> {
        Some(match code {
            0 | 1 => Self::None,
            2 => Self::Gzip,
            3 => Self::Brotli,
            4 => Self::Zstd,
            _ => return None,
        })
    }

    fn decompress(self, uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
        match self {
            Self::None => Ok(bytes),
            Self::Gzip => encoding::gunzip(uri, bytes, limits),
            Self::Zstd => encoding::unzstd(uri, &bytes, limits.max_file_bytes),
            #[cfg(feature = "http")]
            Self::Brotli => encoding::decode(uri, bytes, "br", limits),
            #[cfg(not(feature = "http"))]
            Self::Brotli => Err(IoError::unsupported(uri, "brotli (built without the feature http)")),
        }
    }
}

/// The parsed header of a file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileHeader {
    /// The span of the root directory.
    pub root: Span,
    leaves: Span,
    tiles: Span,
    directory_compression: Compression,
    tile_compression: Compression,
}

impl TileHeader {
    /// Parses the first [`HEAD_BYTES`] of a file.
    pub fn read(uri: &str, head: &[u8]) -> Result<Self, IoError> {
        let broken = |what: &str| IoError::invalid(uri, format!("PMTiles: {what}"));
        if !head.starts_with(b"PMTiles") {
            return Err(broken("its magic is missing"));
        }
        match head.get(7) {
            Some(3) => {}
            Some(other) => return Err(IoError::unsupported(uri, format!("PMTiles of version {other}"))),
            None => return Err(broken("it ends early")),
        }
        let span = |at| Some(Span { offset: le_uint::<8>(head, at)?, size: le_uint::<8>(head, at + 8)? });
        let compression = |at| le_uint::<1>(head, at).and_then(Compression::from_code);
        // The header has 127 bytes.
        let parts = (le_uint::<1>(head, 126), span(8), span(40), span(56));
        let (Some(_), Some(root), Some(leaves), Some(tiles)) = parts else { return Err(broken("it ends early")) };
        let (Some(directory_compression), Some(tile_compression)) = (compression(97), compression(98)) else {
            return Err(IoError::unsupported(uri, "a compression of PMTiles"));
        };
        Ok(Self { root, leaves, tiles, directory_compression, tile_compression })
    }

    /// Decompresses the bytes of a tile.
    pub fn unpack(&self, uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
        self.tile_compression.decompress(uri, bytes, limits)
    }

    /// Decompresses and parses a directory.
    pub fn directory(&self, uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<TileDirectory, IoError> {
        let bytes = self.directory_compression.decompress(uri, bytes, limits)?;
        TileDirectory::read(uri, &bytes, limits)
    }

    /// Looks up a tile in a directory.
    pub fn look_up(&self, directory: &TileDirectory, id: u64) -> Lookup {
        let Some(entry) = directory.find(id) else { return Lookup::Missing };
        let part = if entry.is_directory() { self.leaves } else { self.tiles };
        let span = part.offset.checked_add(entry.offset).map(|offset| Span { offset, size: entry.size });
        match span.filter(|_| entry.offset.checked_add(entry.size).is_some_and(|end| end <= part.size)) {
            Some(span) if entry.is_directory() => Lookup::Directory(span),
            Some(span) => Lookup::Tile(span),
            None => Lookup::OutOfRange,
        }
    }
}

/// Parses any bytes as a file and looks up some tiles. Entry point of the fuzz tests.
#[cfg(feature = "testing")]
pub fn fuzz_pmtiles(bytes: &[u8], limits: &Limits) {
    let Ok(header) = TileHeader::read("fuzz", bytes) else { return };
    for from in [bytes.get(127..).unwrap_or_default(), header.root.slice_of(bytes, 0).unwrap_or_default()] {
        match header.directory("fuzz", from.to_vec(), limits) {
            Ok(directory) => {
                assert!(directory.ids().is_sorted_by(|a, b| a < b));
                for id in directory.ids().take(100).chain([0, 1, u64::MAX]) {
                    let _ = header.look_up(&directory, id);
                }
            }
            Err(error) => assert!(!error.reason().is_empty()),
        }
    }
}
