//! Virtual rasters of GDAL with imagery.

use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;

use super::levels::{Level, Opened};
use crate::GenError;
use crate::georeference::{Crs, Placement};
use crate::store::{BlockCache, BlockReader, PixelImage, Rect};
use crate::virtual_raster::{MAX_DEPTH, Piece, VirtualImage, VirtualPixels, VirtualRaster, VirtualSource};

/// Colours with opacity.
struct Colors;

impl VirtualPixels for Colors {
    const NONE: u32 = 0;

    fn is_some(pixel: u32) -> bool {
        pixel.to_ne_bytes()[3] > 0
    }

    /// The nearest one.
    fn between(corners: [u32; 4], [east, south]: [f64; 2]) -> u32 {
        corners[usize::from(east >= 0.5) + 2 * usize::from(south >= 0.5)]
    }
}

/// The colours of a file in a virtual raster that gives it a colour without data.
struct Masked {
    file: Arc<PixelImage>,
    nodata: [u8; 3],
}

impl BlockReader for Masked {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let mut pixels = self.file.reader().read(block)?;
        let [r, g, b] = self.nodata;
        pixels
            .iter_mut()
            .filter(|pixel| matches!(pixel.to_ne_bytes(), [x, y, z, _] if [x, y, z] == [r, g, b]))
            .for_each(|pixel| *pixel = Colors::NONE);
        Ok(pixels)
    }
}

/// Opens an image file; the reference system is that of a file that names none.
type OpenFile<'a> = dyn Fn(&Path, Option<Crs>) -> Result<Opened, GenError> + Sync + 'a;

/// Opens a virtual raster of GDAL, which is inside of `depth` others. Its bands are those of its files, in the same order.
/// `open_file` opens one of these.
pub(super) fn open(
    path: &Path,
    given: Option<Crs>,
    cache: &Arc<BlockCache>,
    depth: usize,
    open_file: &OpenFile<'_>,
) -> Result<Opened, GenError> {
    let bad = |reason: &str| GenError::invalid(path, format!("VRT: {reason}"));
    if depth >= MAX_DEPTH {
        return Err(bad(&format!("more than {MAX_DEPTH} virtual rasters inside of one another, or a loop of them")));
    }
    let raster = VirtualRaster::open(path, cache)?;
    if raster.warp.is_some() {
        return Err(bad("`VRTWarpedDataset` is not supported for colours; gdal_translate writes it as GeoTIFF"));
    }
    let placement = Placement::of_virtual(path, &raster.metadata, raster.size, given.clone(), cache)?;
    let colors: Vec<_> = raster.bands.iter().filter(|band| !band.is_alpha).take(3).collect();
    // A loop over the sources of the first band covers all bands if each has the same ones.
    let is_copy = |k: usize, source: &VirtualSource| {
        colors.iter().enumerate().all(|(band, own)| {
            own.sources.get(k).is_some_and(|other| {
                (&other.path, other.from, other.to, other.band) == (&source.path, source.from, source.to, band + 1)
                    && other.factor_and_offset == [1.0, 0.0]
            })
        })
    };
    let piece = |(k, source): (usize, &VirtualSource)| {
        if !is_copy(k, source) {
            return Err(bad(
                "its bands are not the bands of its files in their order; gdal_translate writes it as GeoTIFF",
            ));
        }
        // The file's own georeference does not matter, and it need not have one.
        let crs = given.clone().or(Some(Crs::Geographic));
        let opened = open_file(&source.path, crs)?;
        let Some(finest) = opened.levels.into_iter().next() else { return Err(bad("a source without an image")) };
        let [from, to] = source.rectangles(finest.image.grid().size, raster.size);
        let nodata: Option<Vec<u8>> = colors.iter().map(|band| byte(band.sources.get(k)?.nodata?)).collect();
        let image = match nodata.as_deref() {
            Some([grey]) => masked(finest.image, [*grey; 3], cache),
            Some([r, g, b]) => masked(finest.image, [*r, *g, *b], cache),
            _ => finest.image,
        };
        Ok(Piece { image, from, to })
    };
    let sources = colors.first().map(|band| &band.sources).ok_or_else(|| bad("no colours"))?;
    let pieces: Result<Vec<Piece>, GenError> = sources.par_iter().enumerate().map(piece).collect();
    let (grid, image) = VirtualImage::<Colors>::new(raster.size, pieces?);
    let level = Level::finest(PixelImage::new(grid, Box::new(image), cache));
    Ok(Opened { levels: vec![level], placement: placement.unwrap_or_default() })
}

fn masked(file: Arc<PixelImage>, nodata: [u8; 3], cache: &Arc<BlockCache>) -> Arc<PixelImage> {
    Arc::new(PixelImage::new(file.grid(), Box::new(Masked { file, nodata }), cache))
}

/// Returns a whole number of 0..=255.
fn byte(number: f64) -> Option<u8> {
    ((0.0..=255.0).contains(&number) && number.fract() == 0.0).then_some(number as u8)
}
