//! Point clouds.

mod draco;
mod pnts;

pub(super) use pnts::read;
