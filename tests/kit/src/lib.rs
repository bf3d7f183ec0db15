//! The kit that the integration tests and benches of all crates of the workspace share.
//!
//! Tests that need a GPU take the process's [`rig`]; viewers come from [`viewer`]. Each skip of a test goes through
//! [`skip`], so that it is printed and counted.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

pub mod cameras;
pub mod cull_scenes;
pub mod display;
pub mod frames;
pub mod fuzz;
pub mod pager;
pub mod process;
pub mod rig;
pub mod server;
pub mod shadows;
pub mod shapes;
pub mod skip;
pub mod terrain;
pub mod tile_sets;
pub mod viewer;

/// Returns true with `TERRANE_LONG_TESTS=1`: tests of random inputs run all of them instead of a sample.
pub fn long_tests() -> bool {
    std::env::var_os("TERRANE_LONG_TESTS").is_some_and(|v| v == "1")
}
