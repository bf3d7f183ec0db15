//! The position of rasters on the earth: reference systems, transforms from pixels, GeoTIFF tags, world files,
//! geoids and datum grids.

mod crs;
mod datum_grid;
mod geo_keys;
mod geoid;
pub(crate) mod geotiff;
mod half_float;
mod placement;
mod projection;
mod tiff_samples;
mod transform;

pub use crs::{Crs, utm_from_geodetic, utm_to_geodetic};
pub(crate) use datum_grid::DatumGrid;
pub(crate) use geoid::Geoid;
pub use geoid::VerticalDatum;
pub(crate) use placement::{Placement, ROUNDING};
pub use projection::Projection;
pub(crate) use transform::GeoTransform;
