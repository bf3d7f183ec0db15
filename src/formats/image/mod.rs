//! PNG and JPEG to textures with mip levels. CPU only; any thread.

mod decode;
mod mips;
mod rgba;

pub(crate) use decode::decode_file;
pub(super) use decode::{SharedTexture, decode_shared, is_image};
