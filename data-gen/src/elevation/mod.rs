//! Elevation as a function of position: raster files, mosaics of them, and procedural terrain.

mod formats;
mod mosaic;
mod procedural;
mod raster;
mod source;
mod sources;

pub use formats::{HeightEncoding, RasterOptions};
pub(crate) use mosaic::Mosaic;
pub use procedural::Procedural;
pub use raster::Raster;
pub use source::{ElevationSource, SourceSample};
pub(crate) use sources::expand;
