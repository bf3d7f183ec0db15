//! Packed sets (`.terrane`): the files of a tile set in one file, found by level, column, row and kind. Parses bytes, does no
//! I/O. `docs/formats/packed-sets.md` describes every byte.
//!
//! ```text
//! header, table of the index's pages, index, files
//! ```

mod header;
mod key;
mod page;

#[cfg(feature = "testing")]
pub use header::fuzz_packed;
pub(super) use header::{HEAD_BYTES, PackedDirectory, PackedHeader, check_content};
pub(super) use key::key_of;
pub(super) use page::{IndexPage, PackedEntry};
