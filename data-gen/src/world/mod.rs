//! Worlds from a seed: planets whose heights and colours are pure functions of the position.
//!
//! ```text
//! place of a tile -> points on the sphere -> relief: continents, mountains, hills, dunes, craters; the drainage around
//!                                            the points, whose rivers and glaciers cut valleys
//!                                         -> surface: climate, and colours by biome, slope, water and ice
//!                                         -> scatter: trees and rocks
//!                                         -> EXR and image, or a glb mesh of the tile; tilesets of three levels
//! ```
//!
//! Noise is sampled in space, so that the poles and the antimeridian have no seams. A tile is computed alone, on any thread
//! and machine, with the same bytes: `terrane serve --procedural` makes those that clients ask for.

mod args;
mod errors;
mod form;
mod points;
mod preset;
mod relief;
mod scatter;
mod source;
mod surface;
mod tile_errors;
mod tile_form;
mod tiles;
mod tileset;
mod write;

pub use args::WorldArgs;
pub use preset::WorldPreset;
pub(crate) use source::WorldSource;
pub use surface::World;
pub use tiles::{TileStep, WorldSet, WorldTile};
pub(crate) use write::{check_world, shard_roots, tiles_below, world_set, write_world};
