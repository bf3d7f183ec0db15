//! Terrain services of layer.json with tiles of the format quantized-mesh-1.0, and the ellipsoid where there is none. Called
//! by decode threads.
//!
//! | file | contents |
//! |---|---|
//! | `layer` | layer.json, and the layers that it is laid over |
//! | `set` | the layers together |
//! | `read`, `pages` | the tree: root tiles, and pages of tiles that are made when they are wanted |
//! | `availability` | which tiles there are |
//! | `tile` | the content of a tile |
//! | `quantized` | the file of a tile |
//! | `surface` | triangles over the unit square, and parts of them |
//! | `mesh` | vertices on the ellipsoid, normals, skirts |
//! | `water` | which parts of a tile are water |
//! | `tiling` | the rectangles of tiles and the errors of levels |

mod availability;
mod layer;
mod mesh;
mod pages;
mod quantized;
mod read;
mod set;
mod surface;
mod tile;
mod tiling;
mod water;

pub(super) use layer::{Layer, is_layer, is_layer_text, parent_files, read_layers};
pub(super) use pages::TerrainPage;
pub use read::ellipsoid;
pub(super) use read::read;
#[cfg(feature = "http")]
pub(super) use read::read_tiles;
pub use tile::terrain_extent;
pub(super) use tile::{TerrainTile, is_tile_name, read_alone};
