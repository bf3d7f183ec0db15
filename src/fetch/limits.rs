//! [`Limits`] on everything that is read from outside.

use super::error::IoError;

/// Upper limits for data from outside. The defaults are far above what real tile sets hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Bytes of one file, after decompression.
    pub max_file_bytes: u64,
    /// Width and height of an image in pixels.
    pub max_image_side_px: u32,
    /// Bytes of one decoded image. All images of one glTF together may have four times as many.
    pub max_image_bytes: u64,
    /// Tiles of one tileset.json, nodes or vertices of one glTF. Its index lists together may have eight times as many
    /// indices.
    pub max_elements: usize,
    /// Depth of nested tiles and of nested glTF nodes.
    pub max_depth: u32,
    /// Depth of external tilesets inside tilesets.
    pub max_external_depth: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_file_bytes: 512 << 20,
            max_image_side_px: 8192,
            max_image_bytes: 256 << 20,
            max_elements: 16 << 20,
            max_depth: 100,
            max_external_depth: 32,
        }
    }
}

impl Limits {
    /// Fails with [`IoError::TooLarge`] if a file of this size is larger than [`Self::max_file_bytes`].
    pub(crate) fn check_file_bytes(&self, uri: &str, got: u64) -> Result<(), IoError> {
        if got > self.max_file_bytes {
            return Err(IoError::TooLarge { uri: uri.to_owned(), what: "file", got, limit: self.max_file_bytes });
        }
        Ok(())
    }
}
