//! Worlds from a seed: planets whose heights and colours are pure functions of the position.
//!
//! ```text
//! place of a tile -> points on the sphere -> relief (continents, mountains, canyons, dunes, craters)
//!                                         -> climate (temperature, moisture) -> colours (biomes, rock, water)
//!                                         -> EXR and JPEG of the tile; tilesets of three levels
//! ```
//!
//! Noise is sampled in space, so that the poles and the antimeridian have no seams. A tile is computed alone, on any thread
//! and machine, with the same bytes: `terrane serve --procedural` makes those that clients ask for.

mod args;
mod climate;
mod colors;
mod errors;
mod noise;
mod patch;
mod planet;
mod points;
mod preset;
mod relief;
mod tiles;
mod tileset;
mod write;

pub use args::WorldArgs;
pub use planet::World;
pub use preset::WorldPreset;
pub use tiles::{WorldSet, WorldTile};
pub(crate) use write::{check_world, world_set, write_world};
