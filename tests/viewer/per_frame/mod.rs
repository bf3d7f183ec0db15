//! What happens in each frame: callbacks and statistics.

mod callbacks;
mod statistics;
