//! Generated tile sets: the command line, elevation files, reference systems and the tree of tiles.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod cli;
mod date_line;
mod elevation_files;
mod files;
mod formats;
mod fuzz_rasters;
mod nothing_lost;
mod reference_systems;
mod samples;
mod sets;
mod sources;
mod tiffs;
mod tree;
