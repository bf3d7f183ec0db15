//! The colour of tiles: given imagery, and natural colours by height and slope where there is none.

mod imagery;
mod painter;

pub(crate) use imagery::Imagery;
pub(crate) use painter::{Painter, TEXELS};
