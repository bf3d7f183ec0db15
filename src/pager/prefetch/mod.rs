//! Prefetching: where the eye will be, and which contents a frame there would lack. Main thread.

mod motion;
mod path;

pub(crate) use motion::turn_between;
pub use motion::{EyeMotion, MotionLooks};
pub use path::{PathLooks, frames_until};
