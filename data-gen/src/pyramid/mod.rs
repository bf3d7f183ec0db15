//! The grid of heights, and the quadtree of tiles over it, block by block, with measured errors.

mod block;
mod dependencies;
mod extrema;
mod fill;
mod grid;
mod plan;
mod record;
mod samples;
mod surface;
mod tile;

pub(crate) use block::{Below, Block, distance_to_finer_m};
pub(crate) use fill::BOX;
pub(crate) use grid::{ALIGNED, Grid, QUANTUM_M};
pub(crate) use plan::{Layer, Plan, tiles_with_data};
pub(crate) use record::{Record, Totals};
pub(crate) use samples::{Samples, Window};
pub(crate) use surface::{Lattice, Surface};
pub use tile::TileKey;
pub(crate) use tile::{CELLS, Coverage};

#[cfg(test)]
mod tests;
