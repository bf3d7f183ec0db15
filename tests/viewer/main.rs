//! One viewer with one view: loading, refinement, reports and the frames it draws.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod fade;
mod flights;
mod host_device;
mod image_sequences;
mod on_demand;
mod own_readers;
mod per_frame;
mod pipelines;
mod pixels;
mod report;
mod scene;
mod shadows;
#[cfg(all(feature = "window", feature = "http"))]
mod tile_states;
mod timeline;
mod variance;
