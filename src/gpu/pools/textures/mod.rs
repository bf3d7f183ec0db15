//! Textures: the pool of mesh textures, and the textures and samplers of state sets.

mod fallback_textures;
mod image_size;
mod state_textures;
mod texture_pool;
mod texture_rows;
mod wgpu_enums;

pub(crate) use fallback_textures::FallbackTextures;
pub(in crate::gpu::pools) use image_size::{ImageSize, array_view};
pub(crate) use state_textures::{StateTextureBytes, StateTextures};
pub(in crate::gpu) use texture_pool::{TextureLayer, TexturePool};
pub(in crate::gpu) use texture_rows::{TextureRows, write_rows};
pub(in crate::gpu) use wgpu_enums::TexelEncoding;
pub(in crate::gpu) use wgpu_enums::block_formats;
pub(in crate::gpu::pools) use wgpu_enums::{address_mode, filter_mode, mipmap_filter_mode};
pub(crate) use wgpu_enums::{compare_function, texture_format, view_dimension};
