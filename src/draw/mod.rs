//! Draws what cull decided: a [`RenderStage`](crate::cull::RenderStage) becomes a few instanced draws.
//!
//! Runs in the draw phase on the thread that owns the [`GraphicsContext`](crate::gpu::GraphicsContext). It may overlap
//! the next frame's update, since a stage holds no reference into the scene.
//!
//! ```text
//! RenderStage -> its states: pipeline keys, viewports and references, uniforms, textures
//!             -> its leaves, regrouped in bins sorted by state: one storage buffer of leaves,
//!                runs of equal geometry (one instanced draw each) in buckets of equal bindings
//!             -> a render pass: state is set only where it changes; runs of a bucket are one indirect call
//! ```
//! Stages of cameras that are drawn before or after it are separate render passes, into textures or the same target.
//!
//! | folder or file | contents |
//! |---|---|
//! | `renderer` | the [`Renderer`]: prepares, uploads and records a frame as a list of passes |
//! | `passes` | the passes, each with its own pipelines and buffers |
//! | `batch` | from leaves to runs and buckets |
//! | `pipelines` | from keys to render pipelines |
//! | `uniforms` | mirrors of the shaders' structs, buffers and bind groups |
//! | `targets` | the attachments of a stage |
//! | `callbacks` | code of the application that runs while a camera is drawn |
//! | `shaders` | WGSL sources |
//! | `recorder` | records draws and sets only state that changes |
//! | `bins` | draws the bins of a stage, and callbacks around them |
//! | `resources` | the parts that all passes share |

mod batch;
mod bins;
mod bound_state;
mod callbacks;
mod error_log;
mod mapping;
mod passes;
mod pipelines;
mod recorder;
mod renderer;
mod resources;
mod stats;
mod targets;
mod uniforms;

pub use bins::{BinCallback, BinDrawing};
pub use callbacks::attributes::{StateAttribute, state_attribute};
pub use callbacks::camera::CameraCallbacks;
pub use callbacks::drawables::{CompiledDrawable, CustomDrawable, DrawableInfo, custom_geometry};
pub use callbacks::info::{FrameClock, RenderInfo};
pub use pipelines::DRAWABLE_PRELUDE;
pub use renderer::{CameraView, Renderer, ViewChange};
pub(crate) use renderer::{StageKinds, draws_alike};
pub use stats::DrawStats;
