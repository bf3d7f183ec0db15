//! Grids of shifts between datums, and of the heights of geoids, over longitude and latitude.

mod datum_grid;
mod geoid;
mod grid_tiff;

pub(crate) use datum_grid::DatumGrid;
pub(crate) use geoid::Geoid;
pub use geoid::VerticalDatum;
