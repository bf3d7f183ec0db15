//! Render targets: the context's image or the textures of cameras, with the depth buffers and multisampled buffers that
//! belong to them. Draw thread.

mod camera_target;
pub(in crate::draw) mod error;
mod owners;
pub(in crate::draw) mod pass_target;
pub(in crate::draw) mod table;
