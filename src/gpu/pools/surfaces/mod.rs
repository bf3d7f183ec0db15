//! Surfaces of the metallic-roughness model: their maps and factors in GPU memory. Used by the thread of its device.

mod surface_pool;
mod surface_record;

pub(crate) use surface_pool::{SurfacePool, SurfaceSlot};
pub(in crate::gpu) use surface_record::MapLayers;
#[cfg(test)]
pub(crate) use surface_record::{LayeredRecord, SurfaceRecord};
