//! Writers of tiles: glb and EXR height tiles. Used by `data-gen`, by [`convert`](crate::formats::convert) and by applications
//! that generate tiles; never called by the threads of the frame.

mod buffers;
mod glb;
mod height;
mod model;
mod order;

pub use glb::{GlbMesh, write_compressed_glb, write_glb};
pub use height::write_height_exr;
pub(in crate::formats) use model::{Leaf, Model, write_model};
