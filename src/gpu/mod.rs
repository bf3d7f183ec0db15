//! Graphics resources: device and queue, render targets, geometry and texture pools, compile operations.
//!
//! Runs in the draw phase of the frame. Everything here lives on the one thread that owns a
//! [`GraphicsContext`]; no other thread may call `wgpu::Queue` (writing a texture while another thread submits
//! deadlocks in wgpu 30.0.1, upstream issue 9460). Other threads hand over plain data in a [`CompileOperation`]
//! and get back [`DrawSlot`](crate::scene::DrawSlot)s:
//!
//! ```text
//! Drawable -> CompileOperation -> run_compiles (a slice at a time, within a budget) -> Compiled { slots }
//!             slots: height tiles in blocks of texture arrays, meshes in buffers cut into size classes
//! (with a compile thread: places by run_compiles, their contents by that thread, submitted before the next frame)
//! release(slots) -> the places are free at once: uploads run on the same queue, after the draws that used them
//! ```

mod budget;
mod compile;
mod compile_thread;
mod context;
mod custom;
mod drawable;
mod error;
mod faces;
mod height_pool;
mod host_device;
mod layouts;
mod memory;
mod mesh_pool;
mod packing;
mod pipeline_cache;
mod read_back;
mod slots;
mod staging;
mod state_textures;
mod surface;
mod table;
mod target;
mod texture_pool;
mod timer;
mod transients;
mod uploads;
mod watched;

pub use budget::{CompileBudget, CompilePace};
pub use compile::{CompileOperation, CompileStats, Compiled};
pub use context::{AdapterChoice, ContextTraits, GraphicsContext};
pub use custom::{CompileInfo, CustomError, TargetFormats};
pub use error::GpuError;
pub use host_device::HostDevice;
#[cfg(feature = "testing")]
pub use surface::SurfaceAnswer;
pub use target::Acquired;

pub(crate) use custom::{CustomCompile, CustomShape, MOST_COLORS};
pub(crate) use drawable::{BindClass, DrawableEntry, Extent, Shape};
#[cfg(test)]
pub(crate) use height_pool::{HEADER_VECTORS as TABLE_HEADER_VECTORS, MORPH_LEVELS};
pub(crate) use memory::Memory;
pub(crate) use mesh_pool::{MOST_LAYOUTS, MeshPool};
pub(crate) use packing::VertexFormat;
pub(crate) use state_textures::{StateTextures, White, compare_function, texture_format, view_dimension};
pub(crate) use target::DEPTH_FORMAT;
pub(crate) use timer::FrameTimer;
pub(crate) use transients::Transients;
pub(crate) use watched::watched;
