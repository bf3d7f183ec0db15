//! Images: their pixels, the bytes of their file, or its name.

use std::sync::Arc;

use base64::Engine as _;

use super::Reader;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::Number;
use crate::formats::osg::objects::{ImageData, ImageObject, Object, RawImage};

/// How an image was written.
const INLINE_DATA: i64 = 0;
const INLINE_FILE: i64 = 1;

impl Reader<'_> {
    /// Reads an image; `None` if it has no pixels and no name.
    pub(super) fn image(&mut self) -> Result<Option<Arc<ImageObject>>> {
        if self.version > 94 {
            self.input.keyword("ClassName")?;
            self.input.word()?;
        }
        self.input.keyword("UniqueID")?;
        let id = self.unsigned()?;
        match self.objects.get(&id) {
            Some(Object::Image(known)) => return Ok(Some(known.clone())),
            Some(_) => return Ok(None),
            None => {}
        }
        self.input.keyword("FileName")?;
        let file_name = self.input.quoted()?;
        self.input.keyword("WriteHint")?;
        self.integer(Number::I32)?;
        let data = match (self.integer(Number::I32)?, self.input.is_text()) {
            (INLINE_DATA, false) => self.raw_image()?,
            (INLINE_DATA, true) => self.raw_image_of_text()?,
            (INLINE_FILE, false) => {
                let size = self.count()?;
                (size > 0).then(|| self.input.bytes(size)).transpose()?.map(ImageData::File)
            }
            // Text has no bytes of a file.
            _ => (!file_name.is_empty()).then_some(ImageData::External),
        };
        self.object_members()?;
        let image = data.map(|data| Arc::new(ImageObject { file_name, data }));
        self.objects.insert(id, image.clone().map_or(Object::Nothing, Object::Image));
        Ok(image)
    }

    fn raw_image(&mut self) -> Result<Option<ImageData>> {
        let mut words = [0i64; 9];
        for word in &mut words {
            *word = self.integer(Number::I32)?;
        }
        let [_origin, s, t, r, _internal_format, pixel_format, data_type, packing, _allocation] = words;
        let size = self.count()?;
        let bytes = self.input.bytes(size)?;
        // The offsets of the mip levels.
        let levels = self.count()?;
        self.input.numbers(Number::U32, levels)?;
        Ok(raw([s, t, r], pixel_format, data_type, packing, bytes))
    }

    /// Reads the texts of an image's levels. OSG says how many there are, and writes one for all of compressed images.
    fn levels_of_text(&mut self) -> Result<Vec<String>> {
        let count = self.count()?;
        self.input.begin()?;
        let mut levels = Vec::new();
        while levels.len() < count {
            if self.input.matches("}")? {
                return Ok(levels);
            }
            levels.push(self.input.quoted()?);
        }
        self.input.end()?;
        Ok(levels)
    }

    fn raw_image_of_text(&mut self) -> Result<Option<ImageData>> {
        let mut values = |name: &str, count: usize| -> Result<[i64; 3]> {
            self.input.keyword(name)?;
            let mut values = [0; 3];
            for value in values.iter_mut().take(count) {
                *value = self.integer(Number::I32)?;
            }
            Ok(values)
        };
        values("Origin", 1)?;
        let size = values("Size", 3)?;
        values("InternalTextureFormat", 1)?;
        let [pixel_format, ..] = values("PixelFormat", 1)?;
        let [data_type, ..] = values("DataType", 1)?;
        let [packing, ..] = values("Packing", 1)?;
        values("AllocationMode", 1)?;
        self.input.keyword("Data")?;
        let levels = self.levels_of_text()?;
        let engine = base64::engine::GeneralPurpose::new(
            &base64::alphabet::STANDARD,
            base64::engine::general_purpose::PAD
                .with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
        );
        let mut bytes = Vec::new();
        for level in levels {
            let text: String = level.split_ascii_whitespace().collect();
            engine.decode_vec(text, &mut bytes).map_err(|e| OsgError::invalid(format!("image: base64: {e}")))?;
        }
        Ok(raw(size, pixel_format, data_type, packing, bytes))
    }
}

fn raw(size: [i64; 3], pixel_format: i64, data_type: i64, packing: i64, bytes: Vec<u8>) -> Option<ImageData> {
    let (pixel_format, data_type) = (pixel_format as u32, data_type as u32);
    let packing = packing.clamp(1, 8) as u32;
    let image = RawImage { size: size.map(|side| side as i32), pixel_format, data_type, packing, bytes };
    (!image.bytes.is_empty()).then_some(ImageData::Raw(image))
}
