//! Tile trees: the tiles of a page as flat arrays, the slots for their contents, and whether children can replace their
//! tile.
//!
//! Readers build a tree together with its page. Attaching and detaching contents (update thread) keeps the counts of
//! tiles that are not ready, so that a cull reads one integer to know whether children can be drawn.

mod attach;
mod content_volume;
mod external_volume;
mod ground_tiles;
mod rare_tiles;
mod readiness;
mod slots;
mod tile_bounds;
mod tile_contents;
mod tile_info;
mod tile_record;
mod tile_tree_builder;
mod tiles;

pub(crate) use content_volume::ContentShape;
pub(crate) use ground_tiles::GroundTiles;
pub(crate) use readiness::Readiness;
pub(crate) use tile_bounds::{TileBounds, TileEye};
pub(crate) use tile_record::{TileRecord, flag};
pub(crate) use tile_tree_builder::TileTreeBuilder;
pub(crate) use tiles::{TileRoot, Tiles};

pub use slots::{SlotInfo, SlotState};
pub use tile_info::TileInfo;
