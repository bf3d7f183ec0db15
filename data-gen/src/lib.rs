//! Generates tiled terrain from noise or from elevation files.
//!
//! ```text
//! elevation (noise, raster files) -> pyramid::Grid: heights of vertices on WGS84, rounded, gaps filled
//!                                 -> pyramid::Block: a subtree of tiles; each level an exact subset; measured errors
//! color (imagery, noise)          -> output: EXR heights and images, or glb meshes; tilesets
//! ```
//!
//! Blocks are made one after the other, and each leaves a record for the blocks above it, so that memory does not depend on the
//! size of the set.
//!
//! All cores work (rayon), and the number of threads does not change the bytes that are written. No GPU is used.

mod args;
mod body;
mod color;
mod elevation;
mod error;
mod fingerprint;
mod generate;
mod georeference;
mod interrupt;
mod jpeg2000;
mod noise;
mod opened;
mod output;
mod prediction;
mod progress;
mod pyramid;
mod run_args;
mod shards;
mod store;
mod update;
mod virtual_raster;
mod web_tiles;
mod world;

pub use args::{Color, ContentKind, GenArgs, Summary, Voids, with_negative_numbers};
pub use body::BodyArg;
pub use elevation::{
    DEFAULT_CACHE_BYTES, ElevationSource, HeightEncoding, Procedural, Raster, RasterOptions, SampleRow, SourceSample,
};
pub use error::GenError;
pub use generate::{Outcome, default_set, execute, predict, run};
pub use georeference::{Crs, Extent, Projection, VerticalDatum, utm_from_geodetic, utm_to_geodetic};
pub use interrupt::exit_on_interrupt;
pub use output::{ArchiveFormat, OutputArgs, PartialFolder, TextureFormat, TileArgs, Tiling, Triangles};
pub use prediction::{LevelPrediction, Prediction};
pub use progress::Progress;
pub use pyramid::TileKey;
pub use run_args::{PredictionFormat, RunArgs};
pub use shards::{Shard, Sharding};
pub use world::{TileStep, World, WorldArgs, WorldPreset, WorldSet, WorldTile};
