//! PNG and JPEG to RGBA8 textures with mip levels. Sizes are checked before a pixel is decoded.

use std::cell::RefCell;
use std::io::Cursor;
use std::sync::{Arc, OnceLock};

use image::{ColorType, DynamicImage, ImageDecoder as _, ImageFormat, ImageReader, Limits as ImageLimits};

use super::{
    IoError, Limits,
    read::{guarded, refuse_markup},
};
use crate::math::color::{linear_from_srgb, srgb_from_linear};
use crate::scene::{ContentKey, SharedContent, SharedStateManager, Texture};
use crate::state::{CLAMPED, WrapMode};

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
    wrap: [WrapMode; 2],
    limits: &Limits,
    sharing: Option<&SharedStateManager>,
) -> Result<Shared, IoError> {
    let decode = || decode(uri, bytes, wrap, limits);
    match sharing {
        Some(sharing) => sharing.image(ContentKey::of(&[bytes, &wrap.map(|mode| mode as u8)]), decode),
        None => Ok((decode()?, None)),
    }
}

/// Decodes an image and builds its mips.
pub(crate) fn decode(uri: &str, bytes: &[u8], wrap: [WrapMode; 2], limits: &Limits) -> Result<Arc<Texture>, IoError> {
    let format = if bytes.starts_with(b"\x89PNG") {
        ImageFormat::Png
    } else if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
        ImageFormat::Jpeg
    } else {
        refuse_markup(uri, bytes)?;
        return Err(IoError::unsupported(uri, "image that is neither PNG nor JPEG"));
    };
    let bad = |e: image::ImageError| IoError::invalid(uri, format!("image: {e}"));
    let mut image_limits = ImageLimits::default();
    image_limits.max_alloc = Some(limits.max_image_bytes.saturating_mul(2));
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(image_limits.clone());
    let mut decoder = reader.into_decoder().map_err(bad)?;
    let (width, height) = decoder.dimensions();
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
    image_limits.reserve(decoder.total_bytes()).map_err(bad)?;
    decoder.set_limits(image_limits).map_err(bad)?;
    let pixels = if decoder.color_type() == ColorType::Rgb8 {
        opaque(width as usize * height as usize * 3, |rgb| decoder.read_image(rgb)).map_err(bad)?
    } else {
        DynamicImage::from_decoder(decoder).map_err(bad)?.into_rgba8().into_raw()
    };
    Ok(Arc::new(Texture { width, height, mips: mips(width, height, pixels), wrap }))
}

/// [`decode`] of a file by itself, clamped; a panic of a decoder is an error of that file.
pub(crate) fn decode_file(uri: &str, bytes: &[u8], limits: &Limits) -> Result<Arc<Texture>, IoError> {
    guarded(uri, || decode(uri, bytes, CLAMPED, limits))
}

/// Most bytes that a thread keeps for the next image.
const MOST_KEPT_BYTES: usize = 4 << 20;

/// Four bytes a pixel of what is read in three.
fn opaque<E>(bytes: usize, read: impl FnOnce(&mut [u8]) -> Result<(), E>) -> Result<Vec<u8>, E> {
    thread_local! {
        static READ: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    }
    READ.with_borrow_mut(|rgb| {
        if rgb.len() < bytes {
            rgb.resize(bytes, 0);
        }
        let pixels = read(&mut rgb[..bytes]).map(|()| with_alpha(&rgb[..bytes]));
        if rgb.len() > MOST_KEPT_BYTES {
            *rgb = Vec::new();
        }
        pixels
    })
}

/// RGBA from RGB, four pixels at a time.
fn with_alpha(rgb: &[u8]) -> Vec<u8> {
    const ALPHA: u32 = 0xff00_0000;
    let (threes, rest) = rgb.as_chunks::<12>();
    let mut fours: Vec<[[u8; 4]; 4]> = Vec::with_capacity(rgb.len().div_ceil(12));
    fours.extend(threes.iter().map(|three| {
        let word = |k: usize| u32::from_le_bytes([three[k], three[k + 1], three[k + 2], three[k + 3]]);
        let [a, b, c] = [word(0), word(4), word(8)];
        [a, a >> 24 | b << 8, b >> 16 | c << 16, c >> 8].map(|pixel| (pixel | ALPHA).to_le_bytes())
    }));
    let mut out = fours.into_flattened();
    out.extend(rest.as_chunks::<3>().0.iter().map(|&[r, g, b]| [r, g, b, 255]));
    out.into_flattened()
}

/// The whole chain, box filtered in linear light.
pub(crate) fn mips(width: u32, height: u32, level_0: Vec<u8>) -> Vec<Vec<u8>> {
    let (mut w, mut h) = (width as usize, height as usize);
    let mut levels = vec![level_0];
    while w > 1 || h > 1 {
        let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
        let mut next = Vec::with_capacity(nw * nh);
        let above = levels.last().map_or(&[][..], Vec::as_slice);
        if w > 1 && h > 1 {
            for rows in above.chunks_exact(2 * w * 4) {
                let (upper, lower) = rows.split_at(w * 4);
                next.extend(halved(upper, lower));
            }
        } else {
            // A row or a column: a texel is half of two pixels and half of the same two.
            next.extend(halved(above, above));
        }
        levels.push(next.into_flattened());
        (w, h) = (nw, nh);
    }
    levels
}

/// A row of half as many texels from two rows; what is left over of an odd one is not looked at.
fn halved(upper: &[u8], lower: &[u8]) -> impl Iterator<Item = [u8; 4]> {
    let (to_linear, to_srgb) = srgb_tables();
    let pairs = upper.as_chunks::<8>().0.iter().zip(lower.as_chunks::<8>().0);
    pairs.map(|(a, b)| {
        let color = |c: usize| {
            let linear = |of: &[u8; 8]| to_linear[usize::from(of[c])] + to_linear[usize::from(of[c + 4])];
            // Four of 16 bits come to 12 bits and 6.
            to_srgb[((linear(a) + linear(b)) >> 6) as usize & 4095]
        };
        let alpha = [a[3], a[7], b[3], b[7]].map(u32::from).iter().sum::<u32>();
        [color(0), color(1), color(2), ((alpha + 2) / 4) as u8]
    })
}

/// To linear and back.
type Tables = (Box<[u32; 256]>, Box<[u8; 4096]>);

/// sRGB to 16-bit linear, and 12-bit linear back (IEC 61966-2-1).
fn srgb_tables() -> &'static Tables {
    static TABLES: OnceLock<Tables> = OnceLock::new();
    TABLES.get_or_init(|| {
        let mut linear = Box::new([0u32; 256]);
        for (i, l) in linear.iter_mut().enumerate() {
            *l = (linear_from_srgb(i as f64 / 255.0) * 65535.0).round() as u32;
        }
        let mut srgb = Box::new([0u8; 4096]);
        for (i, s) in srgb.iter_mut().enumerate() {
            *s = (srgb_from_linear(i as f64 / 4095.0) * 255.0).round() as u8;
        }
        (linear, srgb)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_bytes_become_four() {
        for pixels in [0usize, 1, 3, 4, 5, 8, 11] {
            let rgb: Vec<u8> = (0..3 * pixels).map(|i| i as u8).collect();
            let expected: Vec<u8> = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
            assert_eq!(with_alpha(&rgb), expected);
            let read = |into: &mut [u8]| {
                into.copy_from_slice(&rgb);
                Ok::<_, ()>(())
            };
            assert_eq!(opaque(rgb.len(), |_| Err("cut")), Err("cut"));
            assert_eq!(opaque(rgb.len(), read), Ok(expected));
        }
    }

    /// Each texel is the mean, in linear light, of those it stands for: of two by two, or of two in a row or column.
    #[test]
    fn texels_are_means_of_what_they_stand_for() {
        let linear = crate::math::color::linear_from_srgb8;
        for (w, h) in [(6u32, 4u32), (7, 5), (1, 9), (8, 1), (2, 3), (3, 2), (1, 1)] {
            let pixels: Vec<u8> = (0..w * h * 4).map(|i| (i * 89 + i * i * 7) as u8).collect();
            let levels = mips(w, h, pixels.clone());
            assert_eq!(levels.len() as u32, 32 - w.max(h).leading_zeros());
            let Some(half) = levels.get(1) else { continue };
            let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
            assert_eq!(half.len() as u32, nw * nh * 4);
            for (x, y, c) in (0..nw * nh * 4).map(|k| (k / 4 % nw, k / 4 / nw, k % 4)) {
                let at = |x: u32, y: u32| pixels[((y.min(h - 1) * w + x.min(w - 1)) * 4 + c) as usize];
                let of = [at(2 * x, 2 * y), at(2 * x + 1, 2 * y), at(2 * x, 2 * y + 1), at(2 * x + 1, 2 * y + 1)];
                let got = half[((y * nw + x) * 4 + c) as usize];
                if c == 3 {
                    let mean = of.map(f64::from).iter().sum::<f64>() / 4.0;
                    assert!((f64::from(got) - mean).abs() <= 0.5, "{w} x {h}: {got} of {of:?}");
                } else {
                    let mean = of.map(linear).iter().sum::<f64>() / 4.0;
                    // The way back has 4,096 steps.
                    let slack = 1.0 / 4096.0;
                    let (low, high) = (linear(got.saturating_sub(1)) - slack, linear(got.saturating_add(1)) + slack);
                    assert!((low..=high).contains(&mean), "{w} x {h}: {got} of {of:?}");
                }
            }
        }
    }

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
