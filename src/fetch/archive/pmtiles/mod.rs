//! PMTiles, version 3: the tiles of an image pyramid in one file, found by their index on a Hilbert curve through nested
//! directories. A tile is named `z/x/y`, with or without a file extension. Parses bytes, does no I/O.

mod directory;
mod directory_cache;
mod header;
mod tile_id;

pub(super) use directory::{Lookup, TileDirectory, check_span_size, too_deep};
pub(super) use directory_cache::DirectoryCache;
#[cfg(feature = "testing")]
pub use header::fuzz_pmtiles;
pub(super) use header::{HEAD_BYTES, MAX_DIRECTORY_DEPTH, TileHeader};
pub(super) use tile_id::tile_id;
