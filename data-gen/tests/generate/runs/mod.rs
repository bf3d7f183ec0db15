//! How runs go: predictions, memory, kills at random moments, updates, batch systems.

mod kills;
mod predictions;
mod slurm;
pub mod updates;
