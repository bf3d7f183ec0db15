//! GeoTIFFs with elevation, read by blocks.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::super::context::SourceContext;
use super::{Opened, RasterOptions};
use crate::GenError;
use crate::georeference::Placement;
use crate::georeference::geotiff::Tiff;
use crate::store::{BlockReader, Rect, WholeReader, whole};

/// An overview may be coarser than what is asked for by this factor: a raster has one sample more than steps.
const MAX_EXCESS: f64 = 1.01;

/// The heights of one channel of a file. The file is opened again if too many others were opened since.
struct Channel {
    path: PathBuf,
    /// The number of the file among the open ones.
    number: u64,
    /// The number of the overview that is read; `None` for the image itself.
    overview: Option<usize>,
    /// The channel, from 0 on.
    channel: usize,
    options: RasterOptions,
    context: Arc<SourceContext>,
}

impl Channel {
    /// Returns the image, opened again if it is not among the open ones.
    fn tiff(&self) -> Result<Arc<Tiff>, GenError> {
        self.context.tiffs.file(self.number, || self.open(0))
    }

    fn heights(&self, tiff: &Tiff, block: Rect) -> Result<Vec<u32>, GenError> {
        let heights = tiff.heights(self.channel, self.options.nodata, block)?;
        Ok(heights.into_iter().map(|height_m| self.options.scaled_m(height_m).to_bits()).collect())
    }

    fn open(&self, cache_bytes: usize) -> Result<Tiff, GenError> {
        let tiff = Tiff::open_caching(&self.path, cache_bytes, &self.context.cache)?;
        let Some(number) = self.overview else { return Ok(tiff) };
        let gone = || GenError::invalid(&self.path, "TIFF: an overview that was there is missing");
        tiff.overviews()?.into_iter().nth(number).ok_or_else(gone)
    }
}

/// Opens a file and reads its tags.
pub(super) fn open(path: &Path, options: &RasterOptions, context: &Arc<SourceContext>) -> Result<Opened, GenError> {
    let number = context.tiffs.new_file();
    let t = context.tiffs.file(number, || Tiff::open(path, &context.cache))?;
    // PNG and EXR files have a default position; a TIFF must have a georeference.
    let placement = Placement::of_tiff(path, &t, options.crs.clone(), &context.cache)?
        .ok_or_else(|| GenError::invalid(path, no_place(&t)))?;
    t.check_samples()?;
    opened(path, number, None, options, context, placement)
}

/// Returns the reason why a file has no place.
fn no_place(tiff: &Tiff) -> &'static str {
    match tiff.has_control_points() {
        true => "placed by ground control points, which are not supported; gdalwarp converts the file",
        false => "no georeference: neither GeoTIFF tags nor a world file beside it",
    }
}

/// Opens the coarsest overview of a file whose pixels are at most `factors` times as wide and as high as those of the file.
/// `None` if there is none. `placement` is that of the file.
pub(super) fn open_overview(
    path: &Path,
    factors: [f64; 2],
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    placement: &Placement,
) -> Result<Option<Opened>, GenError> {
    let full = Tiff::open(path, &context.cache)?;
    let factors_of = |image: &Tiff| [full.width as f64 / image.width as f64, full.height as f64 / image.height as f64];
    let suffices = |image: &Tiff| (0..2).all(|axis| factors_of(image)[axis] <= MAX_EXCESS * factors[axis]);
    let overviews = full.overviews()?;
    let Some(chosen) = overviews.iter().rposition(suffices) else { return Ok(None) };
    let placement = placement.scaled(factors_of(&overviews[chosen]));
    opened(path, context.tiffs.new_file(), Some(chosen), options, context, placement).map(Some)
}

fn opened(
    path: &Path,
    number: u64,
    overview: Option<usize>,
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    placement: Placement,
) -> Result<Opened, GenError> {
    let (path, context) = (path.to_owned(), Arc::clone(context));
    let mut channel = Channel { path, number, overview, channel: 0, options: options.clone(), context };
    let t = channel.tiff()?;
    channel.channel = match (&options.channel, t.channels()) {
        (None, 1) => 0,
        (None, 2) if t.alpha() == Some(1) => 0,
        (None, count) => {
            let reason = format!("TIFF with {count} channels; elevation has one channel, --channel N chooses it");
            return Err(GenError::invalid(&channel.path, reason));
        }
        (Some(name), count) => {
            let number = name.parse().ok().filter(|n| (1..=count).contains(n));
            let reason = || format!("--channel {name}: the TIFF has channels 1 to {count}");
            number.ok_or_else(|| GenError::invalid(&channel.path, reason()))? - 1
        }
    };
    let cache = Arc::clone(&channel.context.cache);
    let (grid, reader): (_, Box<dyn BlockReader>) = match t.grid(true) {
        Some(grid) => (grid, Box::new(channel)),
        None => whole(Box::new(channel), [t.width, t.height], &cache),
    };
    Ok(Opened { grid, reader, placement })
}

impl BlockReader for Channel {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let tiff = self.tiff()?;
        self.heights(&tiff, block)
    }

    fn is_known_empty(&self, block: Rect) -> bool {
        self.tiff().is_ok_and(|tiff| tiff.has_nodata() && tiff.is_missing(self.channel, block))
    }
}

impl WholeReader for Channel {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let tiff = self.open(self.tiff()?.row_bytes())?;
        for step in tiff.row_steps() {
            call(&self.heights(&tiff, step)?)?;
        }
        Ok(())
    }

    fn path(&self) -> &Path {
        &self.path
    }
}
