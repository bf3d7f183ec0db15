//! Generated tile sets: the command line, elevation files, reference systems and the tree of tiles.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod cli;
mod date_line;
mod files;
mod fuzz;
mod grid_files;
mod meshes;
mod outputs;
mod reference_systems;
mod running;
mod runs;
mod samples;
mod sets;
mod sources;
mod tiffs;
mod tree;
mod world_meshes;
mod worlds;
