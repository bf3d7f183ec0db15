//! Writes a tile set: its tiles and tilesets, in a temporary folder that is moved to OUT when it is complete.

mod builder;
mod encoding;
mod journal;
mod mesh;
mod partial_folder;
mod tile_set;
mod tin;
mod tree;

pub(crate) use builder::{Builder, blocks};
pub use encoding::{TextureFormat, TileArgs, Triangles};
pub(crate) use journal::{CompleteTile, Journal};
pub(crate) use partial_folder::MARKER;
pub use partial_folder::PartialFolder;
pub(crate) use tile_set::write_whole;
pub(crate) use tree::{level_errors_m, voids};
