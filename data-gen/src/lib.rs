//! data-gen: noise or real elevation to tiled terrain.
//!
//! ```text
//! source (noise, DEMs) -> grid: the finest level's samples on WGS84, one quantum, gaps filled
//!                      -> pyramid: every level an exact subset; measured errors, height ranges
//!                      -> tiles: EXR heights + JPEG, or glb meshes; tileset.json
//! ```
//! All cores work (rayon); the bytes written do not depend on how many. Never touches a GPU.

mod args;
mod color;
mod dem;
mod error;
mod generate;
mod geotiff;
mod grid;
mod imagery;
mod mesh;
mod mosaic;
mod noise;
mod output;
mod placement;
mod procedural;
mod progress;
mod projection;
mod pyramid;

pub use args::{ContentKind, GenArgs, Summary};
pub use dem::Raster;
pub use error::GenError;
pub use generate::{default_set, run};
pub use grid::{Extent, Grid};
pub use procedural::Procedural;
pub use progress::Progress;
pub use projection::{Crs, utm_from_geodetic, utm_to_geodetic};
pub use pyramid::{Pyramid, TileKey};

/// Heights as a function of place. Called from many threads.
pub trait ElevationSource: Sync {
    /// Metres above the ellipsoid at a longitude and latitude in radians; `None` where nothing is known.
    fn height_m(&self, longitude: f64, latitude: f64) -> Option<f64>;
}
