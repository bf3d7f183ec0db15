//! Writes a tile set: its tiles and `tileset.json`, in a temporary folder that is moved to OUT when it is complete.

mod mesh;
mod partial_folder;
mod tile_set;

pub use partial_folder::PartialFolder;
pub(crate) use tile_set::write_tiles;
