//! [`Tile`]: a tile as all readers of tile trees make it, with its contents, and its conversion to nodes. Decode threads.

mod body;
mod content;
mod s2;
#[allow(clippy::module_inception, reason = "the file holds the type that the folder is named after")]
mod tile;
mod transform;
mod up_axis;
mod volume;

pub use body::Body;
pub(super) use body::ELLIPSOID;
pub(super) use content::{ContentBytes, ContentData, TileContent, with_region};
pub(super) use s2::S2Cell;
pub(super) use tile::{ALWAYS_REFINED_M, Continuation, Tile, node_of};
pub(super) use transform::tile_transform;
pub use up_axis::UpAxis;
pub use volume::TileVolume;
