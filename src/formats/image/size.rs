//! The limit of the size of images.

use crate::fetch::{IoError, Limits};

/// Checks the size of an image before its pixels are decoded.
pub(in crate::formats) fn check_size(uri: &str, width: u32, height: u32, limits: &Limits) -> Result<(), IoError> {
    if width == 0 || height == 0 {
        return Err(IoError::invalid(uri, format!("image of {width} x {height} pixels")));
    }
    let (got, limit) = ((u64::from(width) * u64::from(height)).saturating_mul(4), limits.max_image_bytes);
    if got > limit {
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "image", got, limit });
    }
    Ok(())
}
