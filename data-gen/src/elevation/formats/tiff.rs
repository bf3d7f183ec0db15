//! GeoTIFFs with elevation, read by blocks.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::super::context::SourceContext;
use super::{Opened, RasterOptions, height_bits};
use crate::GenError;
use crate::georeference::Placement;
use crate::georeference::geotiff::Tiff;
use crate::store::{BlockReader, Rect, WholeReader, whole};

/// The heights of one channel of a file. The file is opened again if too many others were opened since.
struct Channel {
    path: PathBuf,
    /// The number of the file among the open ones.
    number: u64,
    /// The channel, from 0 on.
    channel: usize,
    nodata: Option<f64>,
    context: Arc<SourceContext>,
}

/// Opens a file and reads its tags.
pub(super) fn open(path: &Path, options: &RasterOptions, context: &Arc<SourceContext>) -> Result<Opened, GenError> {
    let number = context.tiffs.new_file();
    let t = context.tiffs.file(number, || Tiff::open(path))?;
    let channel = match (&options.channel, t.channels()) {
        (None, 1) => 1,
        (None, count) => {
            let reason = format!("TIFF with {count} channels; elevation has one channel, --channel N chooses it");
            return Err(GenError::invalid(path, reason));
        }
        (Some(name), count) => {
            let number = name.parse().ok().filter(|n| (1..=count).contains(n));
            number.ok_or_else(|| {
                GenError::invalid(path, format!("--channel {name}: the TIFF has channels 1 to {count}"))
            })?
        }
    };
    // PNG and EXR files have a default position; a TIFF must have a georeference.
    let placement = Placement::of_tiff(path, &t, options.crs.clone())?
        .ok_or_else(|| GenError::invalid(path, "no georeference: neither GeoTIFF tags nor a world file beside it"))?;
    t.check_samples()?;
    let channel = Channel {
        path: path.to_owned(),
        number,
        channel: channel - 1,
        nodata: options.nodata,
        context: Arc::clone(context),
    };
    let (grid, reader): (_, Box<dyn BlockReader>) = match t.grid(true) {
        Some(grid) => (grid, Box::new(channel)),
        None => whole(Box::new(channel), [t.width, t.height], &context.cache),
    };
    Ok(Opened { grid, reader, placement })
}

impl BlockReader for Channel {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let tiff = self.context.tiffs.file(self.number, || Tiff::open(&self.path))?;
        Ok(height_bits(tiff.heights(self.channel, self.nodata, block)?))
    }

    fn is_known_empty(&self, block: Rect) -> bool {
        let tiff = self.context.tiffs.file(self.number, || Tiff::open(&self.path));
        tiff.is_ok_and(|tiff| tiff.has_nodata() && tiff.is_missing(self.channel, block))
    }
}

impl WholeReader for Channel {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let bytes = self.context.tiffs.file(self.number, || Tiff::open(&self.path))?.row_bytes();
        let tiff = Tiff::open_caching(&self.path, bytes)?;
        for step in tiff.row_steps() {
            call(&height_bits(tiff.heights(self.channel, self.nodata, step)?))?;
        }
        Ok(())
    }

    fn path(&self) -> &Path {
        &self.path
    }
}
