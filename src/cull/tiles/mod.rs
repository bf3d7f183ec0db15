//! Tile trees: which tiles are drawn, and which are requested. Culling thread.
//!
//! The visitor calls the walk for each root of a tile tree that it meets. The walk reads the tiles' records, bounds and marks
//! of fades. It queues the pages of contents that are drawn, adds a [`PageRequest`](super::PageRequest) to the stage for each
//! content that is missing, and stamps the tiles that it met with the frame number, by which the pager expires the others.
//!
//! | file | content |
//! |---|---|
//! | `walk` | the rules for every kind of tile: refinement, replacement, requests |
//! | `fast_walk` | the same rules for the usual tiles, in one loop each for drawing and requesting |
//! | `walk_context`, `tile_view`, `open_tile` | what a walk knows of its page, of the eye, and of the tiles above |
//! | `ground` | tiles of a globe, which are replaced as soon as the children in sight are ready |
//! | `horizon` | tiles below the horizon of the ellipsoid |
//! | `surface` | large tiles of a globe whose boxes are in sight and whose surface is not |
//! | `stand_in` | the content above a tile whose load has failed |

mod fast_walk;
mod ground;
mod horizon;
mod open_tile;
mod stand_in;
mod surface;
mod tile_view;
mod walk;
mod walk_context;

pub(super) use open_tile::OpenTile;
pub(super) use tile_view::{MAX_ERROR_PX, TileView};
pub(super) use walk_context::shows_children;
