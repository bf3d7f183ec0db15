//! Writes a tile set: its tiles and `tileset.json`, in a temporary folder that is moved to OUT when it is complete.

mod encoding;
mod mesh;
mod partial_folder;
mod tile_set;
mod tin;

pub use encoding::{TextureFormat, TileArgs, Triangles};
pub(crate) use partial_folder::PartialFolder;
pub(crate) use tile_set::write_tiles;
