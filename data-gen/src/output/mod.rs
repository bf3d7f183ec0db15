//! Writes a tile set: its tiles and tilesets, in a temporary folder that is moved to OUT when it is complete.

mod archive;
mod builder;
mod corner_errors;
mod encoding;
mod finish;
mod implicit;
mod journal;
mod mesh;
mod options;
mod packed;
mod partial_folder;
mod set_files;
mod terrain;
mod tile_set;
mod tin;
mod tree;

pub(crate) use builder::{Builder, blocks};
pub(crate) use corner_errors::{CornerErrors, JSON_BYTES as CORNER_ERRORS_JSON_BYTES, RATIO, TileErrors, is_round};
pub use encoding::{TextureFormat, TileArgs, Triangles};
#[cfg(feature = "object-store")]
pub(crate) use finish::is_compressible;
pub(crate) use finish::{finish, is_archive_at};
pub(crate) use implicit::{Entry, SUBTREE_LEVELS, SUBTREES, descendants, subtree, subtree_name, tile_class};
pub(crate) use journal::{CompleteTile, Inputs, Journal, ListedTile, TileList};
pub(crate) use mesh::{Look, MeshForm, MeshTile};
pub use options::{ArchiveFormat, OutputArgs, Tiling};
pub(crate) use packed::{BlockFile, Kind, tiles_and_bytes};
pub use partial_folder::PartialFolder;
pub(crate) use partial_folder::{MARKER, ROOTS};
pub(crate) use set_files::write_whole;
#[cfg(feature = "object-store")]
pub(crate) use set_files::{MANIFEST, each_folder};
pub(crate) use terrain::{METADATA_LEVELS, TerrainSet, Written, spread};
pub(crate) use tile_set::compress;
pub(crate) use tree::{half_step_m, level_errors_m, sagitta_m, undrawn_error_m, voids};
