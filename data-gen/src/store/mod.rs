//! Images of any size as blocks that are decoded when they are needed.
//!
//! ```text
//! a reader (BlockReader) decodes one block of a file -> BlockCache: one for all files of a run, with a byte budget
//! PixelImage: the grid of blocks of one file         -> Cursor: single pixels and parts of rows, held by one thread
//! whole: files that can only be decoded as a whole    -> one block, or blocks in a temporary file
//! remote: files on servers, by ranges of bytes        -> pages, which are blocks as well
//! ```
//!
//! A pixel is a word of 32 bits: the bits of a height in metres (`f32`), or the bytes of red, green, blue and opacity.

mod beside;
mod cache;
mod file_state;
mod image;
mod pool;
mod remote;
mod servers;
mod spill;
mod whole;

pub(crate) use beside::{text_of, with_extension, with_more};
pub(crate) use cache::BlockCache;
pub(crate) use file_state::FileState;
pub(crate) use image::{BlockGrid, BlockReader, Cursor, PixelImage, Rect};
pub(crate) use pool::Pool;
pub(crate) use remote::{RemoteBytes, first_bytes, is_remote};
pub(crate) use servers::remote_versions;
pub(crate) use spill::SpillPart;
pub(crate) use whole::{WholeReader, first_pixel, whole};
