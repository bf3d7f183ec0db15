//! Elevation files of each kind and of any size, archives of tiles, what is kept of samples, and reference systems compared with PROJ.

mod elevation_files;
mod formats;
mod large;
mod nothing_lost;
mod proj_points;
pub mod tile_archives;
