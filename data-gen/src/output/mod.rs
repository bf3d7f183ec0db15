//! Writes a tile set: its tiles and tilesets, in a temporary folder that is moved to OUT when it is complete.

mod archive;
mod builder;
mod encoding;
mod finish;
mod implicit;
mod journal;
mod mesh;
mod normal_map;
mod options;
mod packed;
mod partial_folder;
mod terrain;
mod tile_set;
mod tin;
mod tree;

pub(crate) use builder::{Builder, blocks};
pub use encoding::{TextureFormat, TileArgs, Triangles};
#[cfg(feature = "object-store")]
pub(crate) use finish::{each_folder, is_compressible};
pub(crate) use finish::{finish, is_archive_at};
pub(crate) use implicit::{Entry, SUBTREE_LEVELS, SUBTREES, descendants, subtree, subtree_name, tile_class};
#[cfg(feature = "object-store")]
pub(crate) use journal::MANIFEST;
pub(crate) use journal::{CompleteTile, Inputs, Journal, ListedTile, TileList};
pub(crate) use mesh::{Look, MeshForm, MeshTile};
pub use options::{ArchiveFormat, OutputArgs, Tiling};
pub(crate) use packed::{BlockFile, Kind, tiles_and_bytes};
pub use partial_folder::PartialFolder;
pub(crate) use partial_folder::{MARKER, ROOTS};
pub(crate) use terrain::{METADATA_LEVELS, TerrainSet, Written, spread};
pub(crate) use tile_set::{compress, write_whole};
pub(crate) use tree::{half_step_m, level_errors_m, sagitta_m, undrawn_error_m, voids};
