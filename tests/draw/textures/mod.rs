//! Textures: filters and compressed formats.

mod compressed;
mod filtering;
