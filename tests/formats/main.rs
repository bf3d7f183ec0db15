//! Readers of tile contents: glTF attributes, bad input, sample files, and fuzzing of every parser.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod fuzz_parsers;
mod gltf_attributes;
mod implicit;
mod tiles_bad_input;
mod tiles_read;
mod tiles_samples;
mod tiles_unusual;
