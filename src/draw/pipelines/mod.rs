//! Render pipelines, created when they are first needed: a software adapter takes a third of a second for each at its
//! first draw. Draw thread.
//!
//! ```text
//! key             PipelineKey: everything that pipelines differ in, packed into 128 bits
//! key_parts         and the values that have too many bits for it, by index
//! target_table      and the kinds of targets, by index
//! shader_choice   from a key to shader source and entry points
//! factory         from a key to a pipeline, with programs and custom attributes of the application
//! builder         creates modules and pipelines on the device, catching its errors
//! pipeline_thread the thread that creates pipelines beside the draw thread
//! cache           Pipelines: the pipelines of a renderer by key
//! ```

pub(in crate::draw) mod builder;
pub(in crate::draw) mod builtin_pipelines;
pub(in crate::draw) mod cache;
pub(in crate::draw) mod convert;
pub(in crate::draw) mod custom_attributes;
pub(in crate::draw) mod factory;
pub(in crate::draw) mod key;
pub(in crate::draw) mod key_parts;
pub(in crate::draw) mod pipeline_thread;
pub(in crate::draw) mod programs;
mod shader_choice;
pub(in crate::draw) mod sources;
mod target_table;

pub(in crate::draw) use cache::{PipelineId, Pipelines};
pub use sources::DRAWABLE_PRELUDE;

pub(in crate::draw) use crate::gpu::{MAX_COLOR_ATTACHMENTS, TargetFormats};
