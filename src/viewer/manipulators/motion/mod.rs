//! Motion of the pointer and of fingers, and how it continues after the release. Main thread.

mod eased;
mod image_plane;
mod pinch;
mod pointer;
mod throw;
mod time;

pub(super) use eased::Eased;
pub(super) use pinch::{Pinch, PinchTracker, TouchResult};
pub(super) use pointer::{Gesture, Pointer, PointerMotion, Thrown};
pub(super) use time::{remaining_after, steps};
