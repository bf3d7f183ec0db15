//! Budgets of memory, which pages leave first, and the time that an update takes.

mod eviction;
mod memory;
mod state_textures;
mod update_time;
