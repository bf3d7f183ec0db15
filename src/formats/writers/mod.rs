//! Writers of tiles: glb and EXR height tiles. Used by `data-gen` and by applications that generate tiles; never called by the
//! threads of the frame.

mod glb;
mod height;
mod meshopt;

pub use glb::{GlbMesh, write_compressed_glb, write_glb};
pub use height::write_height_exr;
