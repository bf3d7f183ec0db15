//! Packed sets (`.terrane`): one file for a set, whose tiles are found by an index with their errors, heights and checksums.
//! `docs/formats/packed-sets.md` describes every byte; the library reads them as archives.
//!
//! Each block writes one file into a hidden folder of the set. The last step of a run puts these together, level by level.

mod block_file;
mod entry;
mod set_file;

pub(crate) use block_file::{BlockFile, tiles_and_bytes};
pub(crate) use entry::Kind;
pub(super) use set_file::{MAGIC, write_packed_set};
