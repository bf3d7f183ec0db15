//! Cull without a GPU: leaves, cameras, tile selection, bins and occluders.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod bins;
mod callbacks;
mod leaves;
mod near_far_planes;
mod nested_cameras;
mod node_kinds;
mod occluders;
mod pixel_size;
mod scene_cameras;
mod settings;
mod single_page;
mod tiles;
