//! The samples of the finest level, and the quadtree of tiles over them with measured errors.

mod grid;
mod tiles;

pub(crate) use grid::QUANTUM_M;
pub use grid::{Extent, Grid, Sampling};
pub(crate) use tiles::{CELLS, Coverage};
pub use tiles::{Pyramid, TileKey};
