//! Elevation as a function of position: raster files, mosaics of them, and procedural terrain.
//!
//! ```text
//! sources  the files that --dem and --imagery name
//! formats  opens a file, decodes its blocks  -> raster: one file on the earth, blocks in the cache of the context
//! nearby   finds rasters at a position       -> mosaic: several rasters as one source
//! lattice  quick loops over rectangles of rasters whose axes are meridians and parallels
//! blend    the bands along the edges of overlapping ones
//! ```

mod blend;
mod context;
mod formats;
mod lattice;
mod mosaic;
mod nearby;
mod procedural;
mod raster;
mod raster_source;
mod source;
mod sources;
mod window;

pub use context::DEFAULT_CACHE_BYTES;
pub(crate) use context::SourceContext;
pub(crate) use formats::png_rows;
pub use formats::{HeightEncoding, RasterOptions};
pub(crate) use mosaic::Mosaic;
pub use procedural::Procedural;
pub use raster::Raster;
pub use source::{ElevationSource, SampleRow, SourceSample};
pub(crate) use sources::{expand, open_all, use_overviews};
