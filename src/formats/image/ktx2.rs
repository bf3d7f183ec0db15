//! KTX2 files with Basis Universal textures (KHR_texture_basisu): ETC1S and UASTC.
//!
//! They are transcoded to a compressed format that the adapter samples, or to RGBA8. The header is checked before the
//! transcoder sees it: it allocates what the header says.

use basisu::{TargetFormat, Transcoder};

use super::block_encoder;
use super::mips::{MipFilter, mips};
use super::size::check_size;
use super::transcode::transcode;
use crate::fetch::{IoError, Limits, about_to_allocate};
use crate::scene::{BlockFormats, TexelFormat};

/// The levels of a texture, largest first.
pub(super) struct Levels {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) levels: Vec<Vec<u8>>,
}

/// Chooses the format that a file is transcoded to. The second value says why an image is not compressed though the adapter
/// has a family of formats. For an invalid file the format is RGBA8; [`decode`] returns the error.
pub(super) fn choose_format(
    bytes: &[u8],
    adapter: BlockFormats,
    limits: &Limits,
) -> (TexelFormat, Option<&'static str>) {
    let Ok(header) = Header::new(bytes) else { return (TexelFormat::Rgba8, None) };
    let format = match (adapter, header.is_etc1s, header.has_alpha) {
        (BlockFormats { bc: true, .. }, true, false) => TexelFormat::Bc1,
        (BlockFormats { bc: true, .. }, true, true) => TexelFormat::Bc3,
        (BlockFormats { bc: true, .. }, false, _) => TexelFormat::Bc7,
        (BlockFormats { astc: true, .. }, false, _) => TexelFormat::Astc4x4,
        (BlockFormats { etc2: true, .. }, _, false) => TexelFormat::Etc2Rgb,
        (BlockFormats { etc2: true, .. }, _, true) => TexelFormat::Etc2Rgba,
        (BlockFormats { astc: true, .. }, true, _) => TexelFormat::Astc4x4,
        _ => return (TexelFormat::Rgba8, None),
    };
    let first = header.first_level(limits);
    let (width, height) = header.size(first);
    if width.max(height) > limits.max_image_side_px {
        return (TexelFormat::Rgba8, Some("KTX2 image without a level within the limit of sides (held as RGBA8)"));
    }
    let side = format.block_side();
    if !width.is_multiple_of(side) || !height.is_multiple_of(side) {
        return (TexelFormat::Rgba8, Some("KTX2 image whose sides are no multiples of 4 (held as RGBA8)"));
    }
    (format, None)
}

/// Transcodes a file to a format with all mip levels. Levels that the file lacks are filtered from its last one, as for
/// other images.
pub(super) fn decode(
    uri: &str,
    bytes: &[u8],
    format: TexelFormat,
    filter: MipFilter,
    limits: &Limits,
) -> Result<Levels, IoError> {
    let bad = |reason: &dyn std::fmt::Display| IoError::invalid(uri, format!("KTX2: {reason}"));
    let header = Header::new(bytes).map_err(|reason| bad(&reason))?;
    let (transcoder, first) = open(uri, bytes, &header, limits)?;
    let checked = |level: u32, format: TexelFormat| {
        let (width, height) = header.size(level);
        let texels = transcode(&transcoder, level, format).map_err(|e| bad(&format_args!("level {level}: {e:?}")))?;
        let (got, expected) = (texels.len() as u64, format.image_bytes(width, height));
        match got == expected {
            true => Ok(texels),
            false => Err(bad(&format_args!("level {level} has {got} bytes instead of {expected}"))),
        }
    };
    let last = (first..header.level_count).find(|level| header.size(*level) == (1, 1));
    let last = last.unwrap_or(header.level_count - 1);
    let mut levels = (first..=last).map(|level| checked(level, format)).collect::<Result<Vec<_>, _>>()?;
    let (width, height) = header.size(last);
    if (width, height) != (1, 1) {
        let missing = mips(width, height, checked(last, TexelFormat::Rgba8)?, filter).into_iter().skip(1);
        for (texels, level) in missing.zip(last + 1..) {
            let (width, height) = header.size(level);
            let encoded = block_encoder::encode(width, height, texels, format);
            levels.push(encoded.map_err(|e| bad(&format_args!("level {level}: {e:?}")))?);
        }
    }
    let (width, height) = header.size(first);
    Ok(Levels { width, height, levels })
}

/// Opens a transcoder for a file after a check of its sizes. Returns the first level whose sides are within the limits with
/// it, or the last level.
fn open<'a>(uri: &str, bytes: &'a [u8], header: &Header, limits: &Limits) -> Result<(Transcoder<'a>, u32), IoError> {
    let Header { width, height, level_count, .. } = *header;
    if header.has_depth_layers_or_faces {
        return Err(IoError::unsupported(uri, "KTX2 image with depth, layers or faces"));
    }
    if width == 0 || height == 0 {
        return Err(IoError::invalid(uri, format!("KTX2: {width} x {height} pixels")));
    }
    let first = header.first_level(limits);
    check_size(uri, header.size(first).0, header.size(first).1, limits)?;
    if header.largest_level_bytes > limits.max_image_bytes {
        let (got, limit) = (header.largest_level_bytes, limits.max_image_bytes);
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "KTX2 level", got, limit });
    }
    about_to_allocate(header.largest_level_bytes).map_err(|error| error.at(uri))?;
    let Ok(transcoder) = Transcoder::new(bytes) else {
        return Err(IoError::unsupported(uri, "KTX2 image without a Basis Universal texture"));
    };
    if !transcoder.supports(TargetFormat::Rgba32) || transcoder.base_dimensions() != (width, height) {
        return Err(IoError::unsupported(uri, "KTX2 image with more than 8 bits a channel"));
    }
    if transcoder.level_count() != level_count {
        let reason = format!("KTX2: {} levels instead of {level_count}", transcoder.level_count());
        return Err(IoError::invalid(uri, reason));
    }
    Ok((transcoder, first))
}

/// The color model of ETC1S in a data format descriptor (Khronos Data Format 1.3, `KHR_DF_MODEL_ETC1S`).
const MODEL_ETC1S: u32 = 163;
/// The channels of UASTC with alpha: RGBA and RRRG.
const CHANNELS_WITH_ALPHA: [u32; 2] = [3, 5];

/// The properties of the header that decide on the format, and how much the transcoder allocates (KTX 2.0, section 3).
struct Header {
    width: u32,
    height: u32,
    /// 1 to 32.
    level_count: u32,
    has_depth_layers_or_faces: bool,
    is_etc1s: bool,
    has_alpha: bool,
    /// The largest size of a level before supercompression, as the header declares it.
    largest_level_bytes: u64,
}

impl Header {
    /// Reads the header. Fails unless all of its parts are inside of the file.
    fn new(bytes: &[u8]) -> Result<Self, &'static str> {
        let truncated = "truncated header";
        let word = |at: usize| -> Result<u32, &'static str> {
            let bytes = bytes.get(at..).and_then(|rest| rest.first_chunk());
            Ok(u32::from_le_bytes(*bytes.ok_or(truncated)?))
        };
        let long =
            |at: usize| -> Result<u64, &'static str> { Ok(u64::from(word(at)?) | u64::from(word(at + 4)?) << 32) };
        let check = |offset: u64, length: u64| match offset.checked_add(length) {
            Some(end) if end <= bytes.len() as u64 => Ok(()),
            _ => Err("a part beyond the end of the file"),
        };
        let [width, height, depth, layers, faces, levels] = [20, 24, 28, 32, 36, 40].map(word);
        // The longest chain of levels is that of a side of 2^31.
        let level_count = levels?.max(1);
        if level_count > 32 {
            return Err("too many levels");
        }
        // The data format descriptor, key and value pairs, and data for all levels.
        check(word(48)?.into(), word(52)?.into())?;
        check(word(56)?.into(), word(60)?.into())?;
        check(long(64)?, long(72)?)?;
        let mut largest_level_bytes = 0;
        for level in 0..level_count as usize {
            let at = 80 + 24 * level;
            check(long(at)?, long(at + 8)?)?;
            largest_level_bytes = largest_level_bytes.max(long(at + 16)?);
        }
        let has_depth_layers_or_faces = depth? > 0 || layers? > 1 || faces? != 1;
        // The descriptor of ETC1S has one sample, and a second one for alpha; that of UASTC has one with its channels.
        let (descriptor, descriptor_bytes) = (word(48)? as usize, word(52)?);
        let is_etc1s = word(descriptor.saturating_add(12))? & 0xff == MODEL_ETC1S;
        let channels = word(descriptor.saturating_add(28))? >> 24 & 0xf;
        let has_alpha = if is_etc1s { descriptor_bytes >= 60 } else { CHANNELS_WITH_ALPHA.contains(&channels) };
        Ok(Self {
            width: width?,
            height: height?,
            level_count,
            has_depth_layers_or_faces,
            is_etc1s,
            has_alpha,
            largest_level_bytes,
        })
    }

    /// Returns the width and height of a level.
    fn size(&self, level: u32) -> (u32, u32) {
        let side = |of: u32| of.checked_shr(level).unwrap_or(0).max(1);
        (side(self.width), side(self.height))
    }

    /// Returns the first level whose sides are within the limits, or the last level.
    fn first_level(&self, limits: &Limits) -> u32 {
        let fits = |level: &u32| {
            let (width, height) = self.size(*level);
            width.max(height) <= limits.max_image_side_px
        };
        (0..self.level_count).find(fits).unwrap_or(self.level_count - 1)
    }
}
