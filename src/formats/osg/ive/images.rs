//! Images: their pixels, the bytes of their file, or its name.

use std::sync::Arc;

use super::{Reader, ids};
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::Input as _;
use crate::formats::osg::objects::{ImageData, ImageObject, RawImage};

/// How an image was written.
const REFERENCE: u8 = 0;
const PIXELS: u8 = 1;
const FILE: u8 = 2;
/// Marks an image like [`FILE`], which is named by its extension alone.
const COMPRESSED: u8 = 3;

impl Reader<'_> {
    /// Reads an image; `None` if there is none.
    pub(super) fn image(&mut self) -> Result<Option<Arc<ImageObject>>> {
        if self.version >= 29 {
            if self.class()? == ids::IMAGE_SEQUENCE {
                return self.nested(Self::image_sequence);
            }
            // The class, which OSG does not look at.
            self.unsigned()?;
        }
        let mode = self.byte()?;
        self.image_of_mode(mode)
    }

    /// Reads an image that was written in a mode.
    pub(super) fn image_of_mode(&mut self, mode: u8) -> Result<Option<Arc<ImageObject>>> {
        let (file_name, data) = match mode {
            PIXELS => return Ok(self.optional(Self::raw_image)?.flatten()),
            REFERENCE => (self.string()?, ImageData::External),
            FILE | COMPRESSED => {
                let name = self.string()?;
                let size = self.integer()?;
                // OSG reads the bytes of a file with a name alone.
                match usize::try_from(size) {
                    Ok(size) if size > 0 && !name.is_empty() => (name, ImageData::File(self.input.bytes(size)?)),
                    _ => return Ok(None),
                }
            }
            _ => return Err(OsgError::invalid(format!(".ive: an image in mode {mode}"))),
        };
        Ok((!file_name.is_empty()).then(|| Arc::new(ImageObject { file_name, data })))
    }

    /// Reads an Image with its pixels; `None` if it has none.
    pub(super) fn raw_image(&mut self) -> Result<Option<Arc<ImageObject>>> {
        self.expect(ids::IMAGE)?;
        self.object_members()?;
        let file_name = self.string()?;
        if self.version >= 32 {
            // How it should be written.
            self.integer()?;
        }
        let [s, t, r, _internal_format, pixel_format, data_type, packing, _modified] = self.integers()?;
        // The offsets of the mip levels.
        let levels = self.count(4)?;
        self.skip(levels * 4)?;
        let bytes = self.optional(|reader| {
            let size = reader.count(1)?;
            reader.input.bytes(size)
        })?;
        let Some(bytes) = bytes.filter(|bytes| !bytes.is_empty()) else { return Ok(None) };
        let size = [s, t, r].map(|side| side as i32);
        let raw = RawImage { size, pixel_format, data_type, packing: packing.clamp(1, 8), bytes };
        Ok(Some(Arc::new(ImageObject { file_name, data: ImageData::Raw(raw) })))
    }

    /// Reads an ImageSequence as its first image.
    fn image_sequence(&mut self) -> Result<Option<Arc<ImageObject>>> {
        self.expect(ids::IMAGE_SEQUENCE)?;
        self.object_members()?;
        // Its mode and length.
        self.integer()?;
        self.double()?;
        self.notes.add("OpenSceneGraph class osg::ImageSequence (its first image is drawn)");
        let mut names = self.list(4, Self::string)?.into_iter();
        if let Some(file_name) = names.next() {
            return Ok(Some(Arc::new(ImageObject { file_name, data: ImageData::External })));
        }
        let mut first = None;
        for _ in 0..self.count(5)? {
            let image = self.image()?;
            first = first.or(image);
        }
        Ok(first)
    }
}
