//! Several views, contexts, scenes and threads: composite viewers, slave cameras, shared devices and pagers.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod contexts;
#[cfg(feature = "http")]
mod new_tiles;
#[cfg(feature = "window")]
mod overlays;
mod pager_sharing;
mod picking;
mod remove_scene;
mod scene_cameras;
mod shared_device;
mod shared_pager;
mod spherical;
mod stereo_slaves;
mod threading;
mod threads;
mod views;
