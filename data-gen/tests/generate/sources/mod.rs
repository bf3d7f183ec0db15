//! Sources of any size, archives of tiles, and reference systems compared with PROJ.

mod large;
mod proj_points;
pub mod tile_archives;
