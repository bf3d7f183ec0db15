//! Events, camera manipulators and paths. No GPU, apart from a few tests of `input`.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod events;
mod ground;
mod input;
mod manipulators;
mod path;
mod slave_windows;
mod touch;
mod world;
