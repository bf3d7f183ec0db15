//! Recorded camera paths: control points over time, and their text form.
//!
//! A path is read before a flight and sampled in the update phase.

mod error;
mod path;
mod text;

pub use error::PathError;
pub use path::{AnimationPath, ControlPoint, LoopMode};
