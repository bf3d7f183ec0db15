//! The kit that the integration tests and benches of all crates of the workspace share.
//!
//! Tests that need a GPU take the process's [`rig`]; viewers come from [`viewer`]. Each skip of a test goes through
//! [`skip`], so that it is printed and counted.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

pub mod buckets;
pub mod compressed;
pub mod contents;
pub mod fuzz;
pub mod ive_files;
pub mod osg_files;
pub mod pager;
pub mod quantized;
pub mod server;
pub mod splats;
pub mod subtrees;

use terrane::gpu::AdapterChoice;

mod binary_values;
mod drawing;
mod host;
mod scenes;

pub use drawing::{cameras, frames, rig, viewer};
pub use host::{display, process, skip};
pub use scenes::{bodies, cull_scenes, shadows, shapes, terrain, tile_sets};

/// How long tests wait for what has to happen. It only ends a test that hangs: on a busy machine with many test programs side
/// by side a test of a second took more than a minute.
pub const MAX_WAIT: std::time::Duration = std::time::Duration::from_secs(600);

/// Returns the adapter that tests draw with: the software driver, or any adapter with `TEST_ADAPTER=any`.
pub fn adapter() -> AdapterChoice {
    if std::env::var_os("TEST_ADAPTER").is_some_and(|v| v == "any") {
        AdapterChoice::Any
    } else {
        AdapterChoice::Software
    }
}

/// Returns true with `TERRANE_LONG_TESTS=1`: tests of random inputs run all of them instead of a sample.
pub fn long_tests() -> bool {
    std::env::var_os("TERRANE_LONG_TESTS").is_some_and(|v| v == "1")
}
