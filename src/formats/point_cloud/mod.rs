//! Point clouds of 3D Tiles 1.0 (`pnts`) as meshes of points. Decode threads.

mod draco;
mod pnts;

pub(super) use pnts::read;
