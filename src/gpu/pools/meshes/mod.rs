//! Meshes: vertex and index buffers cut into slots, shared meshes and index lists, and the packed vertex formats. Used by the
//! thread of its device.

mod arenas;
mod index_pool;
mod mesh_pool;
mod vertex_buffers;
mod vertex_packing;

pub(in crate::gpu) use mesh_pool::MeshAllocation;
pub(crate) use mesh_pool::{MeshPool, MeshSlot};
pub(crate) use vertex_buffers::MAX_ATTRIBUTE_LAYOUTS;
pub(crate) use vertex_packing::VertexFormat;
pub(in crate::gpu) use vertex_packing::{interleaved_bytes, short_index_bytes};
