//! KTX2 files with Basis Universal textures (KHR_texture_basisu): ETC1S and UASTC.
//!
//! [`transcode`] can write any format of the transcoder, so that block-compressed textures need only another target. The
//! header is checked before the transcoder sees it: it allocates what the header says.

use basisu::{DecodeFlags, TargetFormat, Transcoder};

use super::decode::check_size;
use super::mips::mips;
use crate::fetch::{IoError, Limits};

/// The first bytes of a KTX2 file.
pub(super) const MAGIC: &[u8] = b"\xabKTX 20\xbb\r\n\x1a\n";

/// The levels of a texture, largest first.
struct Levels {
    width: u32,
    height: u32,
    levels: Vec<Vec<u8>>,
}

/// Decodes a file to RGBA8 with all mip levels. Returns the width and height of the first level with them.
pub(super) fn decode(uri: &str, bytes: &[u8], limits: &Limits) -> Result<(u32, u32, Vec<Vec<u8>>), IoError> {
    let Levels { width, height, mut levels } = transcode(uri, bytes, TargetFormat::Rgba32, limits)?;
    // Levels below those of the file are filtered as for other images.
    let last = levels.len() - 1;
    let (w, h) = ((width >> last).max(1), (height >> last).max(1));
    if let Some(smallest) = levels.pop() {
        levels.extend(mips(w, h, smallest));
    }
    Ok((width, height, levels))
}

/// Transcodes the levels of a file whose sides are within the limits to a format, at least one.
fn transcode(uri: &str, bytes: &[u8], target: TargetFormat, limits: &Limits) -> Result<Levels, IoError> {
    let bad = |reason: String| IoError::invalid(uri, format!("KTX2: {reason}"));
    let header = Header::new(bytes).map_err(|reason| bad(reason.to_owned()))?;
    let Header { width, height, level_count, .. } = header;
    if header.has_depth_layers_or_faces {
        return Err(IoError::unsupported(uri, "KTX2 image with depth, layers or faces"));
    }
    let size = |level: u32| ((width >> level).max(1), (height >> level).max(1));
    let fits = |level: &u32| {
        let (w, h) = size(*level);
        w.max(h) <= limits.max_image_side_px
    };
    let first = (0..level_count).find(fits).unwrap_or(level_count - 1);
    if width == 0 || height == 0 {
        return Err(bad(format!("{width} x {height} pixels")));
    }
    check_size(uri, size(first).0, size(first).1, limits)?;
    if header.largest_level_bytes > limits.max_image_bytes {
        let (got, limit) = (header.largest_level_bytes, limits.max_image_bytes);
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "KTX2 level", got, limit });
    }
    let Ok(transcoder) = Transcoder::new(bytes) else {
        return Err(IoError::unsupported(uri, "KTX2 image without a Basis Universal texture"));
    };
    if !transcoder.supports(target) || transcoder.base_dimensions() != (width, height) {
        return Err(IoError::unsupported(uri, "KTX2 image with more than 8 bits a channel"));
    }
    let transcoded = (first..level_count.min(transcoder.level_count()))
        .take_while(|level| *level == first || size(*level - 1) != (1, 1))
        .map(|level| transcoder.transcode(level, target, DecodeFlags::HIGH_QUALITY));
    let levels = transcoded.collect::<Result<Vec<_>, _>>().map_err(|e| bad(format!("{e:?}")))?;
    if levels.is_empty() {
        return Err(bad("no levels".to_owned()));
    }
    let (width, height) = size(first);
    Ok(Levels { width, height, levels })
}

/// The properties of the header that decide how much the transcoder allocates (KTX 2.0, section 3).
struct Header {
    width: u32,
    height: u32,
    /// 1 to 32.
    level_count: u32,
    has_depth_layers_or_faces: bool,
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
        Ok(Self { width: width?, height: height?, level_count, has_depth_layers_or_faces, largest_level_bytes })
    }
}
