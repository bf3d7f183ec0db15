//! One viewer with one view: loading, refinement, reports and the frames it draws.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod callbacks;
mod fade;
mod holes;
mod host_device;
mod image_sequences;
mod on_demand;
mod pipelines;
mod pixels;
mod report;
mod scene;
mod shadows;
#[cfg(all(feature = "window", feature = "http"))]
mod statistics;
mod tile_states;
mod timeline;
mod variance;
