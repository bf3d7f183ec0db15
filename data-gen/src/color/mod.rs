//! The colour of tiles: given imagery, and natural colours by height and slope where there is none.

mod files;
mod imagery;
mod jpeg2000;
mod levels;
mod painter;
mod tiles;
mod virtual_raster;

pub(crate) use imagery::Imagery;
pub(crate) use painter::{Painter, TEXELS};
