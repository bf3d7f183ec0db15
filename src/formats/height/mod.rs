//! Height tiles: EXR and packed content of tile sets that `data-gen` writes. Decode threads.

mod exr;
mod layout;
mod packed;
mod tile;
mod tile_data;

pub(super) use packed::MAGIC as PACKED_MAGIC;
pub(super) use tile::read;
pub(super) use tile_data::{HeightSet, SetExtras, TileExtras, companions, region};
