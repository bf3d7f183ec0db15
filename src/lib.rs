//! Terrane: a paged large-terrain streaming engine on wgpu.

pub mod cull;
pub mod draw;
pub mod gpu;
pub mod io;
pub mod math;
pub mod pager;
pub mod scene;
pub mod state;
pub mod viewer;
