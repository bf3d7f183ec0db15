//! The machine that runs the tests: virtual displays, separate processes, and skips for what is missing.

pub mod display;
pub mod process;
pub mod skip;
