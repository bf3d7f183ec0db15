//! Tilesets: well-formed and invalid ones, sample files, unusual members, implicit tiling, and metadata.

mod bad_input;
mod bodies;
mod implicit;
mod implicit_heights;
mod measures;
mod metadata;
mod read;
mod samples;
mod semantics;
mod unusual;
