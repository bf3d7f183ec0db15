//! DDS files (DirectDraw Surface) with DXT blocks or 8 bits a channel: the first level of a plain image.

use super::block_decoder::{BlockKind, decode_blocks};
use super::size::check_size;
use crate::fetch::{IoError, Limits};

/// The first bytes of a DDS file.
const MAGIC: &[u8] = b"DDS ";
/// Flags of the pixel format.
const HAS_ALPHA: u32 = 1;
const HAS_FOUR_CC: u32 = 4;
/// The capability of cubes and volumes.
const CUBE_OR_VOLUME: u32 = 0x20_0200;

/// Returns true for the magic of a DDS file.
pub(in crate::formats) fn is_dds(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// The pixels of a file.
enum Pixels {
    Blocks(BlockKind),
    /// The bytes of a pixel, and where red, green, blue and alpha are in it.
    Plain(usize, [Option<usize>; 4]),
}

/// Returns width, height and the RGBA8 texels of the first level.
pub(super) fn decode(uri: &str, bytes: &[u8], limits: &Limits) -> Result<(u32, u32, Vec<u8>), IoError> {
    let bad = |reason: &str| IoError::invalid(uri, format!("DDS: {reason}"));
    let word = |at: usize| -> Result<u32, IoError> {
        let bytes = bytes.get(at..).and_then(|rest| rest.first_chunk());
        Ok(u32::from_le_bytes(*bytes.ok_or_else(|| bad("truncated header"))?))
    };
    let (height, width) = (word(12)?, word(16)?);
    if word(112)? & CUBE_OR_VOLUME != 0 {
        return Err(IoError::unsupported(uri, "DDS image with several faces or layers"));
    }
    check_size(uri, width, height, limits)?;
    let flags = word(80)?;
    let unknown = |what: String| IoError::unsupported(uri, format!("DDS image of format {what}"));
    let (pixels, start) = if flags & HAS_FOUR_CC != 0 {
        match &bytes[84..88] {
            b"DXT1" => (Pixels::Blocks(BlockKind::Bc1 { has_alpha: true }), 128),
            b"DXT2" | b"DXT3" => (Pixels::Blocks(BlockKind::Bc2), 128),
            b"DXT4" | b"DXT5" => (Pixels::Blocks(BlockKind::Bc3), 128),
            b"DX10" => {
                // Numbers of DXGI_FORMAT.
                let pixels = match word(128)? {
                    70..=72 => Pixels::Blocks(BlockKind::Bc1 { has_alpha: true }),
                    73..=75 => Pixels::Blocks(BlockKind::Bc2),
                    76..=78 => Pixels::Blocks(BlockKind::Bc3),
                    27..=29 => Pixels::Plain(4, [0, 1, 2, 3].map(Some)),
                    87 | 91 => Pixels::Plain(4, [2, 1, 0, 3].map(Some)),
                    format => return Err(unknown(format!("DXGI {format}"))),
                };
                (pixels, 148)
            }
            other => return Err(unknown(String::from_utf8_lossy(other).into_owned())),
        }
    } else {
        let bits = word(88)?;
        if bits != 24 && bits != 32 && bits != 8 {
            return Err(unknown(format!("{bits} bits a pixel")));
        }
        let mut places = [None; 4];
        for (place, at) in places.iter_mut().zip([92, 96, 100, 104]) {
            let mask = word(at)?;
            let is_alpha = at == 104;
            *place = match mask {
                0 => None,
                _ if is_alpha && flags & HAS_ALPHA == 0 => None,
                0xff | 0xff00 | 0xff_0000 | 0xff00_0000 => Some((mask.trailing_zeros() / 8) as usize),
                _ => return Err(unknown(format!("mask 0x{mask:x}"))),
            };
        }
        (Pixels::Plain(bits as usize / 8, places), 128)
    };
    let data = bytes.get(start..).ok_or_else(|| bad("truncated header"))?;
    let texels = match pixels {
        Pixels::Blocks(kind) => decode_blocks(kind, width, height, data),
        Pixels::Plain(size, places) => {
            let count = width as usize * height as usize;
            let pixels = data.get(..count * size);
            // A grey image has the mask of red alone.
            let is_grey = places[1].is_none() && places[2].is_none();
            let texel = |pixel: &[u8]| -> [u8; 4] {
                let part = |i: usize, default: u8| match places[if is_grey && i < 3 { 0 } else { i }] {
                    Some(at) => pixel.get(at).copied().unwrap_or(default),
                    None => default,
                };
                [part(0, 0), part(1, 0), part(2, 0), part(3, 255)]
            };
            pixels.map(|pixels| pixels.chunks_exact(size).flat_map(texel).collect())
        }
    };
    Ok((width, height, texels.ok_or_else(|| bad("too few pixels"))?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a file with a pixel format of flags, code, bits and masks.
    fn file(width: u32, height: u32, format: [u32; 7], data: &[u8]) -> Vec<u8> {
        let mut file = vec![0; 128];
        file[..4].copy_from_slice(MAGIC);
        let words = [(12, height), (16, width), (80, format[0]), (84, format[1]), (88, format[2])];
        let masks = [(92, format[3]), (96, format[4]), (100, format[5]), (104, format[6])];
        for (at, word) in words.into_iter().chain(masks) {
            file[at..at + 4].copy_from_slice(&u32::to_le_bytes(word));
        }
        file.extend(data);
        file
    }

    #[test]
    fn blocks_and_plain_pixels_are_read() {
        let limits = Limits::default();
        let dxt1 = file(4, 4, [4, u32::from_le_bytes(*b"DXT1"), 0, 0, 0, 0, 0], &[0, 0xf8, 0, 0, 0, 0, 0, 0]);
        assert_eq!(decode("t", &dxt1, &limits).unwrap(), (4, 4, [255, 0, 0, 255].repeat(16)));
        let bgr = file(1, 2, [0x40, 0, 24, 0xff_0000, 0xff00, 0xff, 0], &[1, 2, 3, 4, 5, 6]);
        assert_eq!(decode("t", &bgr, &limits).unwrap(), (1, 2, vec![3, 2, 1, 255, 6, 5, 4, 255]));
        let grey = file(1, 1, [0x2_0000, 0, 8, 0xff, 0, 0, 0], &[9]);
        assert_eq!(decode("t", &grey, &limits).unwrap().2, [9, 9, 9, 255]);
    }

    #[test]
    fn truncated_and_unknown_files_are_refused() {
        let limits = Limits::default();
        let dxt1 = file(4, 4, [4, u32::from_le_bytes(*b"DXT1"), 0, 0, 0, 0, 0], &[0; 8]);
        for length in [4, 20, 100, 127, 135] {
            assert!(decode("t", &dxt1[..length], &limits).is_err(), "{length}");
        }
        for format in [[4, u32::from_le_bytes(*b"ATI2"), 0, 0, 0, 0, 0], [0x40, 0, 16, 0xf800, 0x7e0, 0x1f, 0]] {
            let error = decode("t", &file(4, 4, format, &[0; 64]), &limits).unwrap_err();
            assert!(matches!(error, IoError::Unsupported { .. }), "{error}");
        }
        assert!(decode("t", &file(0, 4, [4, u32::from_le_bytes(*b"DXT1"), 0, 0, 0, 0, 0], &[0; 8]), &limits).is_err());
    }
}
