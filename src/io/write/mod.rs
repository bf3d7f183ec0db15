//! Writers for what the readers beside them read: glb tiles, EXR height tiles. Used by `data-gen` and by applications
//! that make tiles of their own; no thread of the frame writes.

mod glb;
mod height;

pub use glb::{GlbMesh, write_glb};
pub use height::write_height_exr;
