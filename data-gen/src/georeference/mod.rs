//! The position of rasters on the earth: reference systems, transforms from pixels, GeoTIFF tags and world files.

mod crs;
pub(crate) mod geotiff;
mod placement;
mod transform;

pub use crs::{Crs, utm_from_geodetic, utm_to_geodetic};
pub(crate) use placement::{Placement, ROUNDING};
pub(crate) use transform::GeoTransform;
