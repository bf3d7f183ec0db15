//! Generated tile sets: the command line, elevation files, reference systems and the tree of tiles.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod cli;
mod date_line;
mod elevation_files;
mod files;

mod fuzz_rasters;
mod nothing_lost;
mod proj_points;
mod reference_systems;
mod samples;
mod sets;
mod tiffs;
mod tree;
