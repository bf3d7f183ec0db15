//! Uploads, GPU memory, the pipeline cache and timestamps.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod blocks;
mod buffer_memory;
mod compile;
mod compile_thread;
mod memory;
mod pass_times;
mod pipeline_cache;
mod prewarm;
mod state_textures;
mod times;
