//! The position of rasters on the earth: reference systems, transforms from pixels, GeoTIFF tags, world files,
//! geoids and datum grids.

mod beside;
mod crs;
mod extent;
mod geo_keys;
pub(crate) mod geotiff;
mod grids;
mod half_float;
mod notation;
mod placement;
mod projection;
mod tiff_samples;
mod tiff_webp;
mod transform;
mod wkt;

pub(crate) use beside::{Metadata, files_beside};
pub use crs::{Crs, utm_from_geodetic, utm_to_geodetic};
pub use extent::Extent;
pub(crate) use geo_keys::named_unit_m;
pub use grids::VerticalDatum;
pub(crate) use grids::{DatumGrid, Geoid};
pub(crate) use placement::{Placement, ROUNDING};
pub use projection::Projection;
pub(crate) use transform::GeoTransform;
