//! Callbacks that run, and statistics that are kept, in each frame.

mod callbacks;
mod environment_changes;
mod statistics;
