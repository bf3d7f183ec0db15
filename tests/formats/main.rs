//! Readers of tile contents: glTF attributes, bad input, sample files, and fuzzing of every parser.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod convert;
mod features;
mod fuzz_parsers;
mod gltf_attributes;
mod gltf_builder;
mod gltf_compression;
mod gltf_files;
mod gltf_geometry;
mod gltf_lights;
mod gltf_materials;
mod gltf_outlines;
mod gltf_version1;
mod instances;
mod osg;
mod splats;
mod styles;
mod surface_properties;
mod terrain;
mod tiles;
