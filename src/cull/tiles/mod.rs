//! Tile trees: which tiles are drawn, and which are requested.

mod fast_walk;
mod horizon;
mod open_tile;
mod stand_in;
mod tile_view;
mod walk;
mod walk_context;

pub(super) use open_tile::OpenTile;
pub(super) use tile_view::{MAX_ERROR_PX, TileView};
pub(super) use walk_context::shows_children;
