//! Generates tiled terrain from noise or from elevation files.
//!
//! ```text
//! elevation (noise, raster files) -> pyramid::Grid: the finest level's samples on WGS84, rounded, gaps filled
//!                                 -> pyramid::Pyramid: each level an exact subset; measured errors, height ranges
//! color (imagery, noise)          -> output: EXR heights and JPEG, or glb meshes; tileset.json
//! ```
//!
//! All cores work (rayon), and the number of threads does not change the bytes that are written. No GPU is used.

mod args;
mod color;
mod elevation;
mod error;
mod generate;
mod georeference;
mod noise;
mod output;
mod progress;
mod pyramid;

pub use args::{Color, ContentKind, GenArgs, Summary, Voids};
pub use elevation::{ElevationSource, HeightEncoding, Procedural, Raster, RasterOptions, SourceSample};
pub use error::GenError;
pub use generate::{default_set, run};
pub use georeference::{Crs, Projection, VerticalDatum, utm_from_geodetic, utm_to_geodetic};
pub use output::PartialFolder;
pub use progress::Progress;
pub use pyramid::{Extent, Grid, Pyramid, Sampling, TileKey};
