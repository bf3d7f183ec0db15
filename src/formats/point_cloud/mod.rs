//! Point clouds.

mod pnts;

pub(super) use pnts::read;
