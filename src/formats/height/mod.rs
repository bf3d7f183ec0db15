//! Height tiles: EXR content of tile sets that `data-gen` writes. Decode threads.

mod exr;
mod layout;
mod tile;
mod tile_data;

pub(super) use tile::read;
pub(super) use tile_data::{HeightSet, SetExtras, TileExtras, companions, region};
