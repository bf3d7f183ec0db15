//! Contexts and viewers that draw, and the frames that are read back from them.

pub mod cameras;
pub mod frames;
pub mod rig;
pub mod viewer;
