//! Images of the formats that old databases name: SGI (.rgb, .rgba, .bw, .int) and Targa (.tga).
//!
//! Layouts are those of Silicon Graphics' "The SGI Image File Format" 1.00 and of Truevision's "TGA File Format
//! Specification" 2.0. Rows start at the bottom in both, unless a Targa file says otherwise.

use crate::fetch::{IoError, Limits};
use crate::formats::image;

const SGI_MAGIC: [u8; 2] = [0x01, 0xda];
const SGI_HEADER_BYTES: usize = 512;
const TGA_HEADER_BYTES: usize = 18;

/// An image of RGBA8 texels.
#[derive(Debug, PartialEq)]
pub(super) struct OldImage {
    pub width: u32,
    pub height: u32,
    /// The lowest row first.
    pub texels: Vec<u8>,
}

/// Decodes an image; `None` if it has neither format. Targa has no magic, so that the name decides.
pub(super) fn decode(uri: &str, bytes: &[u8], limits: &Limits) -> Option<Result<OldImage, IoError>> {
    let path = uri.split(['?', '#']).next().unwrap_or_default();
    let is_targa = path.get(path.len().saturating_sub(4)..).is_some_and(|end| end.eq_ignore_ascii_case(".tga"));
    let decoded = match () {
        () if bytes.starts_with(&SGI_MAGIC) => sgi(uri, bytes, limits),
        () if is_targa => targa(uri, bytes, limits),
        () => return None,
    };
    Some(decoded)
}

fn broken(uri: &str, format: &str) -> IoError {
    IoError::invalid(uri, format!("{format} image: it is broken or too short"))
}

fn sgi(uri: &str, bytes: &[u8], limits: &Limits) -> Result<OldImage, IoError> {
    let word = |at: usize| bytes.get(at..at + 2).map_or(0, |b| usize::from(b[0]) << 8 | usize::from(b[1]));
    let long = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let error = || broken(uri, "SGI");
    let (is_packed, bytes_per_channel) = (bytes.get(2) == Some(&1), bytes.get(3).copied());
    let dimensions = word(4);
    let (width, height) = (word(6), if dimensions < 2 { 1 } else { word(8) });
    let channels = if dimensions < 3 { 1 } else { word(10) };
    if bytes_per_channel != Some(1) {
        return Err(IoError::unsupported(uri, "SGI image with two bytes a channel"));
    }
    if !(1..=4).contains(&channels) {
        return Err(error());
    }
    image::check_size(uri, width as u32, height as u32, limits)?;
    let mut texels = vec![255; width * height * 4];
    let mut row = vec![0; width];
    for (channel, y) in (0..channels).flat_map(|channel| (0..height).map(move |y| (channel, y))) {
        let number = channel * height + y;
        if is_packed {
            let start = long(SGI_HEADER_BYTES + 4 * number).ok_or_else(error)?;
            let packed = bytes.get(start..).ok_or_else(error)?;
            unpack(packed, &mut row).ok_or_else(error)?;
        } else {
            let start = SGI_HEADER_BYTES + number * width;
            row.copy_from_slice(bytes.get(start..start + width).ok_or_else(error)?);
        }
        // One channel is grey, two are grey and alpha.
        let targets: &[usize] = match (channels, channel) {
            (1 | 2, 0) => &[0, 1, 2],
            (2, _) => &[3],
            (_, 0) => &[0],
            (_, 1) => &[1],
            (_, 2) => &[2],
            _ => &[3],
        };
        for (texel, value) in texels[y * width * 4..(y + 1) * width * 4].chunks_exact_mut(4).zip(&row) {
            targets.iter().for_each(|target| texel[*target] = *value);
        }
    }
    Ok(OldImage { width: width as u32, height: height as u32, texels })
}

/// Unpacks the runs of a row; `None` if there are too few.
fn unpack(mut packed: &[u8], row: &mut [u8]) -> Option<()> {
    let mut at = 0;
    while at < row.len() {
        let (head, rest) = packed.split_first()?;
        let count = usize::from(head & 0x7f);
        let target = row.get_mut(at..at + count).filter(|_| count > 0)?;
        if head & 0x80 != 0 {
            target.copy_from_slice(rest.get(..count)?);
            packed = &rest[count..];
        } else {
            target.fill(*rest.first()?);
            packed = &rest[1..];
        }
        at += count;
    }
    Some(())
}

fn targa(uri: &str, bytes: &[u8], limits: &Limits) -> Result<OldImage, IoError> {
    let error = || broken(uri, "Targa");
    let header = bytes.get(..TGA_HEADER_BYTES).ok_or_else(error)?;
    let word = |at: usize| usize::from(header[at]) | usize::from(header[at + 1]) << 8;
    let (kind, is_packed) = (header[2] & 7, header[2] & 8 != 0);
    let (width, height) = (word(12), word(14));
    let (has_map, map_first, map_count, map_bits) = (header[1] == 1, word(3), word(5), header[7]);
    let pixel_bytes = usize::from(header[16]).div_ceil(8);
    let is_known = match kind {
        1 => has_map && pixel_bytes == 1,
        2 => (2..=4).contains(&pixel_bytes),
        3 => (1..=2).contains(&pixel_bytes),
        _ => false,
    };
    if !is_known {
        let what = format!("Targa image of type {} with {} bits", header[2], header[16]);
        return Err(IoError::unsupported(uri, what));
    }
    image::check_size(uri, width as u32, height as u32, limits)?;
    let map_start = TGA_HEADER_BYTES + usize::from(header[0]);
    let entry_bytes = usize::from(map_bits).div_ceil(8);
    let map_bytes = if has_map { map_count * entry_bytes } else { 0 };
    let map = bytes.get(map_start..map_start + map_bytes).ok_or_else(error)?;
    let color = |pixel: &[u8]| -> Option<[u8; 4]> {
        Some(match (kind, pixel) {
            (1, [index]) => {
                let entry = usize::from(*index).checked_sub(map_first)? * entry_bytes;
                bgr(map.get(entry..entry + entry_bytes)?)?
            }
            (3, [grey]) => [*grey, *grey, *grey, 255],
            (3, [grey, alpha]) => [*grey, *grey, *grey, *alpha],
            (_, pixel) => bgr(pixel)?,
        })
    };
    let mut data = bytes.get(map_start + map_bytes..).ok_or_else(error)?;
    let count = width * height;
    let mut texels = Vec::with_capacity(count * 4);
    let mut next = |n: usize| -> Result<&[u8], IoError> {
        let (taken, rest) = data.split_at_checked(n).ok_or_else(error)?;
        data = rest;
        Ok(taken)
    };
    while texels.len() < count * 4 {
        let (is_run, length) = match is_packed {
            true => {
                let head = next(1)?[0];
                (head & 0x80 != 0, usize::from(head & 0x7f) + 1)
            }
            false => (false, count),
        };
        let length = length.min(count - texels.len() / 4);
        match is_run {
            true => {
                let color = color(next(pixel_bytes)?).ok_or_else(error)?;
                (0..length).for_each(|_| texels.extend(color));
            }
            false => {
                for pixel in next(length * pixel_bytes)?.chunks_exact(pixel_bytes) {
                    texels.extend(color(pixel).ok_or_else(error)?);
                }
            }
        }
    }
    // A file may begin with the highest row.
    if header[17] & 0x20 != 0 {
        let rows: Vec<&[u8]> = texels.chunks_exact(width * 4).rev().collect();
        texels = rows.concat();
    }
    Ok(OldImage { width: width as u32, height: height as u32, texels })
}

/// Converts a pixel of blue, green, red and alpha; `None` if it has another size.
fn bgr(pixel: &[u8]) -> Option<[u8; 4]> {
    Some(match pixel {
        [low, high] => {
            let bits = u16::from(*low) | u16::from(*high) << 8;
            let part = |shift: u16| ((bits >> shift & 31) * 255 / 31) as u8;
            [part(10), part(5), part(0), 255]
        }
        [blue, green, red] => [*red, *green, *blue, 255],
        [blue, green, red, alpha] => [*red, *green, *blue, *alpha],
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(uri: &str, bytes: &[u8]) -> Result<OldImage, IoError> {
        decode(uri, bytes, &Limits::default()).expect("a known format")
    }

    fn sgi_file(is_packed: bool, channels: u8, data: &[u8]) -> Vec<u8> {
        let mut file = vec![0x01, 0xda, u8::from(is_packed), 1, 0, 3, 0, 2, 0, 2, 0, channels];
        file.resize(SGI_HEADER_BYTES, 0);
        file.extend(data);
        file
    }

    #[test]
    fn sgi_images_are_read_plain_and_packed() {
        let plain = sgi_file(false, 3, &[1, 2, 3, 4, 11, 12, 13, 14, 21, 22, 23, 24]);
        let image = read("a.rgb", &plain).unwrap();
        assert_eq!((image.width, image.height), (2, 2));
        assert_eq!(image.texels, [1, 11, 21, 255, 2, 12, 22, 255, 3, 13, 23, 255, 4, 14, 24, 255]);
        // Grey with alpha: a run and a copy in each row.
        let mut packed = Vec::new();
        for row in 0..4u32 {
            packed.extend((SGI_HEADER_BYTES as u32 + 32 + 3 * row).to_be_bytes());
        }
        packed.extend([0; 16]);
        packed.extend([2, 7, 0, 0x82, 8, 9, 2, 5, 0, 2, 6, 0]);
        let image = read("a.inta", &sgi_file(true, 2, &packed)).unwrap();
        assert_eq!(image.texels, [7, 7, 7, 5, 7, 7, 7, 5, 8, 8, 8, 6, 9, 9, 9, 6]);
        for length in [3, 100, plain.len() - 1] {
            assert!(read("a.rgb", &plain[..length]).is_err(), "{length}");
        }
        assert!(read("a.rgb", &sgi_file(true, 2, &[0xff; 16])).is_err());
    }

    fn targa_file(kind: u8, bits: u8, descriptor: u8, data: &[u8]) -> Vec<u8> {
        let mut file = vec![0, 0, kind, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 2, 0, bits, descriptor];
        file.extend(data);
        file
    }

    #[test]
    fn targa_images_are_read_plain_packed_and_mapped() {
        let texels = |kind, bits, descriptor, data: &[u8]| {
            read("A.TGA", &targa_file(kind, bits, descriptor, data)).unwrap().texels
        };
        let bgr = [3, 2, 1, 6, 5, 4, 9, 8, 7, 12, 11, 10];
        let rgb = [1, 2, 3, 255, 4, 5, 6, 255, 7, 8, 9, 255, 10, 11, 12, 255];
        assert_eq!(texels(2, 24, 0, &bgr), rgb);
        assert_eq!(texels(2, 24, 0x20, &bgr), [&rgb[8..], &rgb[..8]].concat(), "the highest row is first");
        assert_eq!(
            texels(10, 24, 0, &[0x82, 3, 2, 1, 0, 6, 5, 4]),
            [&rgb[..4], &rgb[..4], &rgb[..4], &rgb[4..8]].concat()
        );
        assert_eq!(texels(3, 8, 0, &[1, 2, 3, 4])[4..8], [2, 2, 2, 255]);
        assert_eq!(
            texels(2, 16, 0, &[0, 0x7c, 0xe0, 3, 0x1f, 0, 0, 0])[..12],
            [255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 255]
        );
        let mut mapped = targa_file(1, 8, 0, &[30, 20, 10, 60, 50, 40, 0, 1, 1, 0]);
        (mapped[1], mapped[5], mapped[7]) = (1, 2, 24);
        assert_eq!(read("a.tga", &mapped).unwrap().texels[..8], [10, 20, 30, 255, 40, 50, 60, 255]);
        let plain = targa_file(2, 24, 0, &bgr);
        assert!((0..plain.len()).all(|length| read("a.tga", &plain[..length]).is_err()));
        assert!(decode("a.png", &plain, &Limits::default()).is_none());
        let limits = Limits { max_image_bytes: 15, ..Limits::default() };
        assert!(matches!(decode("a.tga", &plain, &limits), Some(Err(IoError::TooLarge { .. }))));
    }
}
