//! Skips of tests that cannot run on this machine. Each is reported on stderr and counted.
//!
//! The line `skipped: REASON` appears although the harness captures the output of tests that pass. If the variable
//! `TERRANE_SKIPPED` names a file, the reason is appended to it; `tools/run test` counts its lines at the end.

use std::fs::OpenOptions;
use std::io::Write as _;

use terrane::gpu::{ContextTraits, GpuError, GraphicsContext};
use terrane::viewer::ViewerError;

/// Prints and counts the skip of a test, or of a part of it.
pub fn skipped(reason: impl std::fmt::Display) {
    let line = format!("skipped: {reason}\n");
    // The harness captures the printing macros, so the line is written to stderr directly. A failure is ignored.
    let _ = std::io::stderr().write_all(line.as_bytes());
    if let Some(path) = std::env::var_os("TERRANE_SKIPPED") {
        // One write per line, so that lines of several processes do not mix.
        let file = OpenOptions::new().create(true).append(true).open(path);
        file.and_then(|mut file| file.write_all(format!("{reason}\n").as_bytes())).unwrap();
    }
}

/// Skips a test that has no adapter or display. Panics with `REQUIRE_GPU=1`, which CI sets.
pub fn skipped_unless_required(reason: impl std::fmt::Display) {
    assert!(std::env::var_os("REQUIRE_GPU").is_none_or(|v| v != "1"), "REQUIRE_GPU=1: {reason}");
    skipped(reason);
}

/// Returns `None`, and skips the test, if there is no adapter; any other error is a failure.
pub fn or_skip<T>(made: Result<T, impl Into<ViewerError>>) -> Option<T> {
    match made.map_err(Into::into) {
        Ok(made) => Some(made),
        Err(ViewerError::Gpu(error @ GpuError::NoAdapter { .. })) => {
            skipped_unless_required(error);
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Returns true, and skips the test, if a context with these traits finds no adapter.
pub fn no_adapter_for(traits: &ContextTraits) -> bool {
    or_skip(GraphicsContext::new_offscreen(traits)).is_none()
}

/// Returns true, and skips the test, if there is no adapter at all.
pub fn no_adapter() -> bool {
    no_adapter_for(&ContextTraits::default())
}
