//! Textures: the pool of mesh textures, and the textures and samplers of state sets. Used by the thread of its device.

mod fallback_textures;
mod image_size;
mod state_textures;
mod texture_pool;
mod texture_rows;

pub(crate) use fallback_textures::FallbackTextures;
pub(in crate::gpu::pools) use image_size::{ImageSize, array_view};
pub(crate) use state_textures::{StateTextureBytes, StateTextures};
pub(in crate::gpu) use texture_pool::{TextureLayer, TexturePool};
pub(in crate::gpu) use texture_rows::{TextureRows, write_rows};
