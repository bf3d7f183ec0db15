//! Executing what cull decided: a [`RenderStage`](crate::cull::RenderStage) becomes a few instanced draws.
//!
//! Runs in the draw phase, on the thread that owns the [`GraphicsContext`](crate::gpu::GraphicsContext); may
//! overlap the next frame's update, since a stage holds no reference into the scene.
//!
//! ```text
//! RenderStage -> leaves with their keys (pipeline, block, geometry), regrouped inside bins sorted by state
//!             -> one storage buffer of per-leaf data, one uniform of per-frame data
//!             -> runs of equal keys: one instanced draw each, state set only where it changes
//!             -> sky behind everything opaque, before the first pipeline that writes no depth
//! ```

mod batch;
mod environment;
mod frame;
mod key;
mod pipelines;
mod renderer;

pub use environment::{Environment, Fog, Sky};
pub use renderer::{DrawStats, Renderer};
