//! PNG and JPEG to RGBA8 textures with mip levels. Sizes are checked before a pixel is decoded.

use std::io::Cursor;
use std::sync::{Arc, OnceLock};

use image::{ImageFormat, ImageReader, Limits as ImageLimits};

use super::{IoError, Limits};
use crate::scene::{ContentKey, SharedContent, SharedStateManager, Texture};

/// True for the magic bytes of PNG or JPEG.
pub(crate) fn is_image(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG") || bytes.starts_with(&[0xff, 0xd8, 0xff])
}

/// An image and, where it is shared, what stands for it.
pub(crate) type Shared = (Arc<Texture>, Option<Arc<SharedContent>>);

/// [`decode`], or the image that others decoded from the same bytes.
pub(crate) fn decode_shared(
    uri: &str,
    bytes: &[u8],
    repeat: bool,
    limits: &Limits,
    sharing: Option<&SharedStateManager>,
) -> Result<Shared, IoError> {
    let decode = || decode(uri, bytes, repeat, limits);
    match sharing {
        Some(sharing) => sharing.image(ContentKey::of(&[bytes, &[u8::from(repeat)]]), decode),
        None => Ok((decode()?, None)),
    }
}

/// Decodes an image and builds its mips.
pub(crate) fn decode(uri: &str, bytes: &[u8], repeat: bool, limits: &Limits) -> Result<Arc<Texture>, IoError> {
    let format = if bytes.starts_with(b"\x89PNG") {
        ImageFormat::Png
    } else if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
        ImageFormat::Jpeg
    } else {
        return Err(IoError::unsupported(uri, "image that is neither PNG nor JPEG"));
    };
    let bad = |e: image::ImageError| IoError::invalid(uri, format!("image: {e}"));
    let (width, height) = ImageReader::with_format(Cursor::new(bytes), format).into_dimensions().map_err(bad)?;
    let too_large = |got: u64, limit: u64| IoError::TooLarge { uri: uri.to_owned(), what: "image", got, limit };
    if width == 0 || height == 0 {
        return Err(IoError::invalid(uri, format!("image of {width} x {height} pixels")));
    }
    let side = width.max(height);
    if side > limits.max_image_side_px {
        return Err(too_large(side.into(), limits.max_image_side_px.into()));
    }
    let size = u64::from(width) * u64::from(height) * 4;
    if size > limits.max_image_bytes {
        return Err(too_large(size, limits.max_image_bytes));
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut image_limits = ImageLimits::default();
    image_limits.max_alloc = Some(limits.max_image_bytes.saturating_mul(2));
    reader.limits(image_limits);
    let pixels = reader.decode().map_err(bad)?.into_rgba8().into_raw();
    Ok(Arc::new(Texture { width, height, mips: mips(width, height, pixels), repeat }))
}

/// [`decode`] of a file by itself, clamped; a panic of a decoder is an error of that file.
pub(crate) fn decode_file(uri: &str, bytes: &[u8], limits: &Limits) -> Result<Arc<Texture>, IoError> {
    let decode = || decode(uri, bytes, false, limits);
    std::panic::catch_unwind(decode).unwrap_or_else(|_| Err(IoError::invalid(uri, super::DECODER_PANICKED)))
}

/// The whole chain, box filtered in linear light.
pub(crate) fn mips(width: u32, height: u32, level_0: Vec<u8>) -> Vec<Vec<u8>> {
    let (to_linear, to_srgb) = srgb_tables();
    let (mut w, mut h) = (width as usize, height as usize);
    let mut levels = vec![level_0];
    while w > 1 || h > 1 {
        let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
        let mut next = vec![0u8; nw * nh * 4];
        if let Some(above) = levels.last() {
            let (dx, dy) = (if w > 1 { 4 } else { 0 }, if h > 1 { w * 4 } else { 0 });
            for (y, out_row) in next.chunks_exact_mut(nw * 4).enumerate() {
                let row = &above[(if h > 1 { 2 * y } else { 0 }) * w * 4..];
                for (x, out) in out_row.chunks_exact_mut(4).enumerate() {
                    let at = if w > 1 { 8 * x } else { 0 };
                    for c in 0..3 {
                        let sum = to_linear[row[at + c] as usize]
                            + to_linear[row[at + dx + c] as usize]
                            + to_linear[row[at + dy + c] as usize]
                            + to_linear[row[at + dx + dy + c] as usize];
                        out[c] = to_srgb[(sum >> 6) as usize];
                    }
                    let alpha = u32::from(row[at + 3])
                        + u32::from(row[at + dx + 3])
                        + u32::from(row[at + dy + 3])
                        + u32::from(row[at + dx + dy + 3]);
                    out[3] = ((alpha + 2) / 4) as u8;
                }
            }
        }
        levels.push(next);
        (w, h) = (nw, nh);
    }
    levels
}

/// To linear and back.
type Tables = (Box<[u32; 256]>, Box<[u8; 4096]>);

/// sRGB to 16-bit linear, and 12-bit linear back (IEC 61966-2-1).
fn srgb_tables() -> &'static Tables {
    static TABLES: OnceLock<Tables> = OnceLock::new();
    TABLES.get_or_init(|| {
        let mut linear = Box::new([0u32; 256]);
        for (i, l) in linear.iter_mut().enumerate() {
            let s = i as f64 / 255.0;
            let v = if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) };
            *l = (v * 65535.0).round() as u32;
        }
        let mut srgb = Box::new([0u8; 4096]);
        for (i, s) in srgb.iter_mut().enumerate() {
            let v = i as f64 / 4095.0;
            let e = if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
            *s = (e * 255.0).round() as u8;
        }
        (linear, srgb)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mips_keep_a_flat_colour() {
        let levels = mips(5, 3, [200, 100, 50, 255].repeat(15));
        assert_eq!(levels.len(), 3);
        for level in &levels {
            for p in level.chunks_exact(4) {
                assert!(p[0].abs_diff(200) <= 1 && p[1].abs_diff(100) <= 1 && p[2].abs_diff(50) <= 2, "{p:?}");
            }
        }
    }
}
