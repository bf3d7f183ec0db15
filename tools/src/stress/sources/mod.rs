//! The tile sets of a flight, and the local servers that serve them.

mod archive_writer;
pub mod servers;
pub mod tile_sets;
