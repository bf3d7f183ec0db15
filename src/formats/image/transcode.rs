//! Levels of KTX2 files in the formats of textures, by the transcoder of Basis Universal. Decode threads.

use basisu::{DecodeFlags, Error, TargetFormat, Transcoder};

use crate::scene::TexelFormat;

/// The first bytes of a KTX2 file.
pub(super) const MAGIC: &[u8] = b"\xabKTX 20\xbb\r\n\x1a\n";

/// Transcodes a level. wgpu has no BC1 without alpha, so blocks of three colours, whose fourth value is transparent, are
/// forbidden.
pub(super) fn transcode(transcoder: &Transcoder<'_>, level: u32, format: TexelFormat) -> Result<Vec<u8>, Error> {
    let target = match format {
        TexelFormat::Rgba8 => TargetFormat::Rgba32,
        TexelFormat::Bc1 => TargetFormat::Bc1Rgb,
        TexelFormat::Bc3 => TargetFormat::Bc3Rgba,
        TexelFormat::Bc7 => TargetFormat::Bc7Rgba,
        // ETC1 is a part of ETC2.
        TexelFormat::Etc2Rgb => TargetFormat::Etc1Rgb,
        TexelFormat::Etc2Rgba => TargetFormat::Etc2Rgba,
        TexelFormat::Astc4x4 => TargetFormat::Astc4x4Rgba,
    };
    transcoder.transcode(level, target, DecodeFlags::HIGH_QUALITY | DecodeFlags::BC1_FORBID_THREE_COLOR_BLOCKS)
}
