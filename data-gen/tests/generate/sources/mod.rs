//! Elevation files of each kind and of any size, archives of tiles, files on servers, imagery, what is kept of samples, and reference systems compared with PROJ.

mod bad_input;
mod beside;
mod datum_grids;
mod elevation_files;
mod formats;
mod gdal_formats;
mod imagery;
mod large;
#[cfg(feature = "mbtiles")]
mod mbtiles;
mod nothing_lost;
mod proj_points;
pub mod rasters;
mod servers;
pub mod tile_archives;
