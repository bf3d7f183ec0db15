//! JPEG 2000 (ISO 15444-1), in boxes (`.jp2`) or without them (`.j2k`), decoded by the crate `hayro-jpeg2000`. A file is placed by
//! the TIFF in its GeoJP2 box, by GML in its GMLJP2 box (OGC 05-047r3), or by the files beside it.
//!
//! Elevation and imagery read the header when they open a file; a thread of the run decodes the image as a whole.

mod boxes;
mod header;

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use hayro_jpeg2000::{DecodeSettings, DecodedImage, DecoderContext, Image};
use terrane::fetch::DECODER_PANICKED;

use crate::GenError;
use crate::georeference::{Crs, Metadata, Placement};
use crate::store::{BlockCache, FileState};
use boxes::{Boxes, CODESTREAM, grid_of_gml};
pub(crate) use header::{Component, Header};

/// The largest file.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// Returns true for the first bytes of a file.
pub(crate) fn is_jpeg2000(magic: &[u8]) -> bool {
    magic.starts_with(&[0, 0, 0, 12, b'j', b'P']) || magic.starts_with(&CODESTREAM)
}

/// A file whose boxes and header were read.
pub(crate) struct Jpeg2000 {
    path: PathBuf,
    pub header: Header,
    boxes: Boxes,
    state: FileState,
}

impl Jpeg2000 {
    /// Opens a file whose image has at most a number of samples.
    pub fn open(path: &Path, max_samples: u64) -> Result<Self, GenError> {
        let state = FileState::of(path)?;
        let mut file = File::open(path).map_err(GenError::file(path))?;
        let boxes = Boxes::read(&mut file, state.bytes()).map_err(GenError::file(path))?;
        let start = boxes.codestream.ok_or_else(|| bad(path, &"no codestream"))?;
        if state.bytes() > MAX_FILE_BYTES {
            let reason = format!("{} bytes, at most {MAX_FILE_BYTES} are decoded at once", state.bytes());
            return Err(bad(path, &reason));
        }
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(start)).map_err(GenError::file(path))?;
        file.take(header::MAX_BYTES).read_to_end(&mut bytes).map_err(GenError::file(path))?;
        let header = Header::parse(&bytes, state.bytes(), boxes.palette_channels, max_samples);
        let header = header.map_err(|reason| bad(path, &reason))?;
        Ok(Self { path: path.to_owned(), header, boxes, state })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns an error of the file.
    pub fn bad(&self, reason: &dyn std::fmt::Display) -> GenError {
        bad(&self.path, reason)
    }

    /// Returns the placement of the file: GDAL's metadata beside it stand above its boxes, and these above a world file. `None`
    /// without any of them. `given` is the reference system of files that do not name one.
    pub fn placement(
        &self,
        given: Option<Crs>,
        metadata: &Metadata,
        cache: &Arc<BlockCache>,
    ) -> Result<Option<Placement>, GenError> {
        let (path, size) = (&self.path, self.header.size);
        if metadata.transform.is_none() {
            if let Some(tiff) = &self.boxes.geotiff
                && let Some(found) = Placement::of_embedded(path, tiff, size, given.clone(), cache)?
            {
                return Ok(Some(found));
            }
            if let Some((transform, system)) = self.boxes.texts.iter().find_map(|text| grid_of_gml(text)) {
                let own = system.map_or_else(|| metadata.clone(), |system| Metadata::of_system(path, &system));
                return Placement::of_header(path, transform, size, given, &own, cache).map(Some);
            }
        }
        Placement::of_image(path, size, given, cache)
    }

    /// Decodes the image and calls with its components. Those with colours have them as RGB, grey or CMYK, of a palette as well if
    /// `is_colored`. The second argument is true if the last component is the opacity.
    pub fn decode<R>(
        &self,
        is_colored: bool,
        call: impl FnOnce(&DecodedImage<'_>, bool) -> Result<R, GenError>,
    ) -> Result<R, GenError> {
        self.state.check(&self.path)?;
        let bytes = std::fs::read(&self.path).map_err(GenError::file(&self.path))?;
        let settings = DecodeSettings { resolve_palette_indices: is_colored, ..DecodeSettings::default() };
        let decode = || {
            let image = Image::new(&bytes, &settings).map_err(|e| self.bad(&e))?;
            let mut context = DecoderContext::default();
            let decoded = image.decode(&mut context).map_err(|e| self.bad(&e))?;
            let [width, height] = self.header.size;
            if decoded.components().iter().any(|component| component.samples().len() != width * height) {
                return Err(self.bad(&"another size than in the header"));
            }
            call(&decoded, image.has_alpha())
        };
        // The decoder is another's, and asserts what it expects of a file.
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode));
        result.unwrap_or_else(|_| Err(self.bad(&DECODER_PANICKED)))
    }
}

fn bad(path: &Path, reason: &dyn std::fmt::Display) -> GenError {
    GenError::invalid(path, format!("JPEG 2000: {reason}"))
}
