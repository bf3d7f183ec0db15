//! The debug view of the pager: boxes of tiles, coloured by level or state. Main thread, in update.

#[cfg(feature = "window")]
mod boxes;
mod handler;
mod tile_colors;
mod tile_state;

pub use handler::PagerDebugHandler;
pub use tile_colors::TileColors;
pub use tile_state::TileState;
