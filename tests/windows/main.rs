//! Real windows on virtual displays. Each test starts this program again, because a process has one event loop.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[cfg(all(target_os = "linux", feature = "window"))]
mod set_ups;
#[cfg(all(target_os = "linux", feature = "window"))]
mod surfaces;
#[cfg(all(target_os = "linux", feature = "window"))]
mod windows;
