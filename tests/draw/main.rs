//! The renderer: leaves, terrain, sky and shadows. The tests share one GPU rig and run one at a time.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod atmosphere;
mod bins;
mod draw_calls;
mod drawables;
mod images;
mod light;
mod local_lights;
mod queries;
mod samples;
mod shadows;
mod sky;
mod splats;
mod surfaces;
mod textures;
mod tiles;
mod tones;
