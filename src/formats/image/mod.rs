//! PNG, JPEG, WebP, GIF, BMP, TIFF, KTX2 and DDS to textures with mip levels. CPU only; any thread.

mod block_decoder;
mod block_encoder;
mod dds;
mod decode;
mod files;
mod ktx2;
mod mips;
mod rgba;
mod size;
mod transcode;

pub(super) use block_decoder::{BlockKind, decode_blocks};
pub(super) use dds::is_dds;
pub(crate) use decode::decode_file;
pub(super) use decode::{ImageUse, SharedTexture, decode_shared, is_image, size_of, texture_of_rgba};
pub use files::ImageFiles;
pub(super) use mips::{MipFilter, mips};
pub(super) use size::check_size;
