//! Tilesets: well-formed and invalid ones, sample files, unusual members, and implicit tiling.

mod bad_input;
mod implicit;
mod read;
mod samples;
mod unusual;
