//! Writers of tiles: glb, EXR and packed height tiles, and quantized-mesh terrain. Used by `data-gen`, by
//! [`convert`](crate::formats::convert) and by applications that generate tiles; never called by the threads of the frame.

mod buffers;
mod container;
mod glb;
mod height;
mod model;
mod order;
mod packed_heights;
mod quantized_mesh;

pub use container::container as glb_container;
pub use glb::{GlbMesh, GlbNormalMap, GlbRoughness, write_compressed_glb, write_glb};
pub use height::write_height_exr;
pub(in crate::formats) use model::{Leaf, LeafShape, Model, write_model};
pub use packed_heights::write_packed_heights;
pub use quantized_mesh::{TerrainMesh, write_quantized_mesh};
