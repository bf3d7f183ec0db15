//! Surfaces of the metallic-roughness model: their maps and factors in GPU memory.

mod surface_pool;
mod surface_record;

pub(in crate::gpu) use surface_pool::MapLayers;
pub(crate) use surface_pool::{SurfacePool, SurfaceSlot};
#[cfg(test)]
pub(crate) use surface_record::SurfaceRecord;
