//! Accessors of a glTF: checked slices of its buffers, converted to numbers.
//!
//! [`Buffers`] finds the bytes of a buffer view, decompressed if necessary; [`Elements`] are the elements of one accessor.

mod buffers;
mod elements;
mod indices;
mod meshopt;
mod quantized;
mod sparse;

pub(super) use buffers::{BUFFER_MISSING, Buffers};
pub(super) use elements::{Elements, attribute_format, columns_and_rows};
pub(super) use indices::{IndexLists, list_key_of};
