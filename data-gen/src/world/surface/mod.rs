//! A planet and what its ground looks like: heights and rivers by rows, climate, and the colours of a patch.

mod climate;
mod colors;
mod lumps;
mod patch;
mod patch_lattice;
mod planet;

pub(super) use patch::{Patch, Site, TEXELS_PER_CELL, rounded};
pub(super) use patch_lattice::Lattice;
pub(super) use planet::RowBuffers;
pub use planet::World;
