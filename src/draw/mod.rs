//! Executing what cull decided: a [`RenderStage`](crate::cull::RenderStage) becomes a few instanced draws.
//!
//! Runs in the draw phase, on the thread that owns the [`GraphicsContext`](crate::gpu::GraphicsContext); may
//! overlap the next frame's update, since a stage holds no reference into the scene.
//!
//! ```text
//! RenderStage -> its states: pipeline keys, viewports and references, uniforms, textures
//!             -> its leaves, regrouped inside bins sorted by state: one storage buffer of per-leaf data,
//!                runs of equal geometry (one instanced draw each) in buckets of equal bindings
//!             -> a pass: state set only where it changes; runs of a bucket by one indirect call
//! ```
//! Stages of cameras that are drawn before or after are passes before or after, into textures or the same target.

mod answers;
mod atmosphere;
mod batch;
mod callbacks;
mod composite;
mod pipelines;
mod plan;
mod renderer;
mod resolve;
mod shadow_maps;
mod spread;
mod state;
mod uniforms;

pub use callbacks::bins::BinDrawing;
pub use callbacks::drawables::{CompiledDrawable, CustomDrawable, DRAWABLE_PRELUDE, DrawableInfo, custom_geometry};
pub use callbacks::{BinCallback, CameraCallbacks, RenderInfo};
pub use renderer::{DrawStats, FrameClock, Picture, Renderer};

pub use crate::scene::{Environment, Fog, Sky, Water};
