//! Graphics resources: device and queue, render targets, pools of geometry and textures, and uploads to them.
//!
//! Runs in the draw phase of the frame, on the one thread that owns a [`GraphicsContext`]. No other thread may call
//! `wgpu::Queue`: a texture write by one thread while another submits deadlocks in wgpu 30.0.1 (upstream issue 9460). Other
//! threads hand over plain data in a [`CompileOperation`] and get back [`DrawSlot`](crate::scene::DrawSlot)s.
//!
//! ```text
//! context   GraphicsContext: opens the device, owns its targets, pools and uploads
//! upload    CompileOperation -> slots, then their contents within a budget -> Compiled
//! pools     slots for height tiles and textures in blocks of array textures, for meshes in buffers of one size class
//! memory    allocations whose failure is an error of their caller
//! ```
//! Each layer uses those below it.

mod context;
mod error;
mod error_scope;
mod memory;
mod pools;
mod upload;

pub use context::{Acquired, AdapterChoice, ContextTraits, GraphicsContext, HostDevice};
pub use error::GpuError;
pub use pools::{CompileInfo, CustomError, TargetFormats};
pub use upload::{CompileBudget, CompileOperation, CompilePace, CompileStats, Compiled};

#[cfg(feature = "testing")]
pub use context::SurfaceAnswer;

pub(crate) use context::{DEPTH_FORMAT, FrameTimer, TransientAttachments, is_encoded_by_shader};
pub(crate) use error_scope::catch_errors;
pub(crate) use memory::Memory;
pub(crate) use pools::{
    BindClass, CustomCompile, CustomShape, DrawableEntry, Extent, FallbackTextures, MAX_ATTRIBUTE_LAYOUTS,
    MAX_COLOR_ATTACHMENTS, MeshPool, Pools, Shape, StateTextures, VertexFormat, Viewpoint, compare_function,
    texture_format, view_dimension,
};
#[cfg(test)]
pub(crate) use pools::{HEADER_VECTORS as TABLE_HEADER_VECTORS, LINEAR_HARMONICS, LayeredRecord, SurfaceRecord};
