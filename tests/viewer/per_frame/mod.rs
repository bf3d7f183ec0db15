//! Callbacks that run, and statistics that are kept, in each frame; what cameras and targets get from the configuration.

mod callbacks;
mod display;
mod environment_changes;
mod new_states;
mod statistics;
