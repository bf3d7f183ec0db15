//! What the ground looks like: climate, and the colours of a patch.

mod climate;
mod colors;
mod lumps;
mod patch;

pub(super) use climate::{FROZEN_C, WINDWARD_M, Weather};
pub(super) use patch::{Lattice, MARGIN, Patch, Site, TEXELS_PER_CELL};
