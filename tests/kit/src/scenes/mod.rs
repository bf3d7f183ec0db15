//! Scenes, drawables, terrain and tile sets to test with.

pub mod bodies;
pub mod cull_scenes;
pub mod shadows;
pub mod shapes;
pub mod terrain;
pub mod tile_sets;
