//! Converts sets of every format that is read to 3D Tiles 1.1: the job of `terrane convert`. Blocking; for tools, not for
//! frames.
//!
//! ```text
//! items     a content is divided into what it draws and the tiles below it
//! contents  reads a content, writes what it draws as a glb, and decodes that for comparison
//! tiles     bounds, geometric errors and JSON of the tiles, from the leaves upwards
//! run       the threads that take items
//! crop      copies the files of a part of a set, without conversion
//! written   counts the levels of the written set
//! ```

mod contents;
mod crop;
mod items;
mod report;
mod run;
mod tiles;
mod written;

pub use crop::crop;
pub use report::{ConvertError, ConvertOptions, Converted, Counts};
pub use run::convert;
