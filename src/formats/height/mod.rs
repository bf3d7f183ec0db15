//! Height tiles: EXR and packed content of tile sets that `data-gen` writes. Decode threads.

mod corner_errors;
mod exr;
mod layout;
mod packed;
mod tile;
mod tile_data;

pub(super) use corner_errors::{CornerErrors, are_valid as are_valid_errors};
pub(super) use packed::MAGIC as PACKED_MAGIC;
pub(super) use tile::read;
pub(super) use tile_data::{HeightSet, HeightTileJson, PlacedErrors, SetExtras, TileExtras, companions, region};
