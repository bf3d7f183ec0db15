//! The limit of the size of images, and the memory that they take. Decode threads.

use crate::fetch::{IoError, Limits, about_to_allocate};

/// Checks the size of an image before its pixels are decoded, and counts the memory of its texels.
pub(in crate::formats) fn check_size(uri: &str, width: u32, height: u32, limits: &Limits) -> Result<(), IoError> {
    check_area(uri, width, height, limits)?;
    // All levels together have a third more than the first.
    about_to_allocate(u64::from(width) * u64::from(height) * 4 / 3 * 4).map_err(|error| error.at(uri))
}

/// Checks the size of an image that is not decoded now.
pub(super) fn check_area(uri: &str, width: u32, height: u32, limits: &Limits) -> Result<(), IoError> {
    if width == 0 || height == 0 {
        return Err(IoError::invalid(uri, format!("image of {width} x {height} pixels")));
    }
    let (got, limit) = ((u64::from(width) * u64::from(height)).saturating_mul(4), limits.max_image_bytes);
    if got > limit {
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "image", got, limit });
    }
    Ok(())
}
