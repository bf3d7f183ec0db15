//! PNG, JPEG, WebP and KTX2 to textures with mip levels. CPU only; any thread.

mod block_encoder;
mod decode;
mod ktx2;
mod mips;
mod rgba;

pub(crate) use decode::decode_file;
pub(super) use decode::{SharedTexture, decode_shared, is_image, size_of};
pub(super) use mips::mips;
