//! Generated tile sets: the command line, elevation files, reference systems and the tree of tiles.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod cli;
mod date_line;
mod elevation_files;
mod files;
mod meshes;

mod fuzz_rasters;
mod nothing_lost;
mod reference_systems;
mod running;
mod samples;
mod sets;
mod tiffs;
mod tree;
mod worlds;
