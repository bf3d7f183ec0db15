//! Decodes PNG and JPEG to RGBA8 textures. Sizes are checked before any pixel is decoded.

use std::io::Cursor;
use std::sync::Arc;

use image::{ColorType, DynamicImage, ImageDecoder as _, ImageFormat, ImageReader, Limits as ImageLimits};

use super::mips::mips;
use super::rgba::decode_rgb;
use crate::fetch::markup::refuse_markup;
use crate::fetch::{IoError, Limits, guarded};
use crate::scene::{ContentKey, SharedContent, SharedStateManager, Texture};
use crate::state::{CLAMPED, WrapMode};

/// Returns true for the magic bytes of PNG or JPEG.
pub(in crate::formats) fn is_image(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG") || bytes.starts_with(&[0xff, 0xd8, 0xff])
}

/// A texture and, if it is shared between contents, its reference count.
pub(in crate::formats) type SharedTexture = (Arc<Texture>, Option<Arc<SharedContent>>);

/// Decodes an image, or returns the texture that another content decoded from the same bytes.
pub(in crate::formats) fn decode_shared(
    uri: &str,
    bytes: &[u8],
    wrap: [WrapMode; 2],
    limits: &Limits,
    sharing: Option<&SharedStateManager>,
) -> Result<SharedTexture, IoError> {
    let decode = || decode(uri, bytes, wrap, limits);
    match sharing {
        Some(sharing) => sharing.image(ContentKey::of(&[bytes, &wrap.map(|mode| mode as u8)]), decode),
        None => Ok((decode()?, None)),
    }
}

/// Decodes an image and builds its mip levels.
fn decode(uri: &str, bytes: &[u8], wrap: [WrapMode; 2], limits: &Limits) -> Result<Arc<Texture>, IoError> {
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
        decode_rgb(width as usize * height as usize * 3, |rgb| decoder.read_image(rgb)).map_err(bad)?
    } else {
        DynamicImage::from_decoder(decoder).map_err(bad)?.into_rgba8().into_raw()
    };
    Ok(Arc::new(Texture { width, height, mips: mips(width, height, pixels), wrap }))
}

/// Decodes the bytes of an image file to a clamped texture. If the decoder panics, only this file fails.
pub(crate) fn decode_file(uri: &str, bytes: &[u8], limits: &Limits) -> Result<Arc<Texture>, IoError> {
    guarded(uri, || decode(uri, bytes, CLAMPED, limits))
}
