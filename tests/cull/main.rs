//! Cull without a GPU: what a visitor takes from a scene, tile selection, bins and occluders.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod bins;
mod leaves;
mod occluders;
mod pixel_size;
mod request_volumes;
mod scene_cameras;
mod special;
mod tile_rules;
mod tiles;
