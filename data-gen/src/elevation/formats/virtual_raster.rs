//! Virtual rasters of GDAL with elevation.

use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;

use super::super::context::SourceContext;
use super::{Opened, RasterOptions, is_tiff, open_at};
use crate::GenError;
use crate::georeference::geotiff::Tiff;
use crate::georeference::{Crs, Placement};
use crate::store::{BlockReader, PixelImage, Rect, first_bytes};
use crate::virtual_raster::{MAX_DEPTH, Piece, VirtualImage, VirtualPixels, VirtualRaster, VirtualSource};

/// Heights in metres, as bits.
struct Heights;

impl VirtualPixels for Heights {
    const NONE: u32 = f32::NAN.to_bits();

    fn is_some(pixel: u32) -> bool {
        !f32::from_bits(pixel).is_nan()
    }

    /// Interpolates; beside unknown heights the nearest one counts.
    fn between(corners: [u32; 4], [east, south]: [f64; 2]) -> u32 {
        let [nw, ne, sw, se] = corners.map(|pixel| f64::from(f32::from_bits(pixel)));
        let height = (nw * (1.0 - east) + ne * east) * (1.0 - south) + (sw * (1.0 - east) + se * east) * south;
        let nearest = corners[usize::from(east >= 0.5) + 2 * usize::from(south >= 0.5)];
        if height.is_nan() { nearest } else { (height as f32).to_bits() }
    }
}

/// Opens a virtual raster, which is inside of `depth` others, and the headers of its files.
pub(super) fn open(
    path: &Path,
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    depth: usize,
) -> Result<Opened, GenError> {
    let (raster, pieces) = pieces(path, options, context, depth, None)?;
    let placement = Placement::of_virtual(path, &raster.metadata, raster.size, options.crs.clone(), &context.cache)?;
    let placement = placement.ok_or_else(|| bad(path, "no georeference"))?;
    let (grid, image) = VirtualImage::<Heights>::new(raster.size, pieces.into_iter().map(|(piece, _)| piece).collect());
    Ok(Opened { grid, reader: Box::new(image), placement })
}

/// Opens a virtual raster whose files are read by their overviews, and whose pixels are at most `factors` times as wide and as high.
/// `None` if a file has no such overview. `placement` is that of the virtual raster.
pub(super) fn open_overview(
    path: &Path,
    factors: [f64; 2],
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    placement: &Placement,
) -> Result<Option<Opened>, GenError> {
    let (raster, pieces) = pieces(path, options, context, 0, Some(factors))?;
    let finest = |[x, y]: [f64; 2], (_, [own_x, own_y]): &(Piece, [f64; 2])| [x.min(*own_x), y.min(*own_y)];
    let coarser = pieces.iter().fold(factors, finest);
    if coarser.iter().any(|factor| *factor <= 1.0) {
        return Ok(None);
    }
    let size = [0, 1].map(|axis| (raster.size[axis] as f64 / coarser[axis]).ceil() as usize);
    let pieces = pieces.into_iter().map(|(mut piece, _)| {
        piece.to = [0, 1, 2, 3].map(|k| piece.to[k] / coarser[k % 2]);
        piece
    });
    let (grid, image) = VirtualImage::<Heights>::new(size, pieces.collect());
    Ok(Some(Opened { grid, reader: Box::new(image), placement: placement.scaled(coarser) }))
}

fn bad(path: &Path, reason: impl std::fmt::Display) -> GenError {
    GenError::invalid(path, format!("VRT: {reason}"))
}

/// The pieces of a band, each with the width and the height of a pixel of its image in pixels of the virtual raster: 1, unless the
/// image is an overview.
type Pieces = Vec<(Piece, [f64; 2])>;

/// Returns a virtual raster and the pieces of the band with heights. `coarser` is how coarse overviews may be.
fn pieces(
    path: &Path,
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    depth: usize,
    coarser: Option<[f64; 2]>,
) -> Result<(VirtualRaster, Pieces), GenError> {
    if depth >= MAX_DEPTH {
        let reason = format!("more than {MAX_DEPTH} virtual rasters inside of one another, or a loop of them");
        return Err(bad(path, reason));
    }
    let raster = VirtualRaster::open(path, &context.cache)?;
    let number = match (&options.channel, raster.bands.iter().filter(|band| !band.is_alpha).count()) {
        (None, 1) => 1,
        (None, count) => {
            return Err(bad(path, format!("{count} bands; elevation has one channel, --channel N chooses it")));
        }
        (Some(name), _) => {
            let number = name.parse().ok().filter(|n| (1..=raster.bands.len()).contains(n));
            number.ok_or_else(|| bad(path, format!("--channel {name}: it has bands 1 to {}", raster.bands.len())))?
        }
    };
    let nodata = raster.metadata.nodata_of(number);
    let own_units = raster.metadata.factor_and_offset_m(number).map_err(|reason| bad(path, reason))?;
    let piece = |source: &VirtualSource| {
        let (channel, nodata) = (Some(source.band.to_string()), source.nodata.or(nodata).or(options.nodata));
        // The file's own georeference does not matter, and it need not have one.
        let crs = options.crs.clone().or(Some(Crs::Geographic));
        // Formats of one channel have no names for it.
        let magic = first_bytes(&source.path, &context.cache)?;
        let is_tiff = is_tiff(&magic);
        let is_named = is_tiff || source.band != 1;
        let mut inner = RasterOptions { channel: channel.filter(|_| is_named), nodata, crs, ..options.clone() };
        // The factor of the options is that of heights, which the virtual raster makes of a TIFF's samples.
        if is_tiff {
            (inner.height_scale, inner.height_offset) = (None, 0.0);
        }
        let mut opened = open_at(&source.path, &inner, context, depth + 1)?;
        let of_file = match is_tiff {
            true => Tiff::open(&source.path, &context.cache)?.units(source.band - 1),
            false => [1.0, 0.0],
        };
        let [mut from, to] = source.rectangles(opened.grid.size, raster.size);
        let mut wider = [1.0; 2];
        if let Some(coarser) = coarser {
            // The pixels of a file may be smaller than those of the virtual raster.
            let factors = [0, 1].map(|axis| coarser[axis] * from[axis + 2] / to[axis + 2]);
            let found = super::open_overview(&source.path, factors, &inner, context, &opened.placement)?;
            if let Some(overview) = found {
                let share = [0, 1].map(|axis| overview.grid.size[axis] as f64 / opened.grid.size[axis] as f64);
                from = [0, 1, 2, 3].map(|k| from[k] * share[k % 2]);
                wider = [0, 1].map(|axis| to[axis + 2] / from[axis + 2]);
                opened = overview;
            }
        }
        let [factor, offset] = source.factor_and_offset;
        // A virtual raster scales the samples of a file, not its heights. Without a factor its units are copies of the file's,
        // or stand in for those that it lacks.
        let is_scaled = source.factor_and_offset != [1.0, 0.0];
        let [factor, offset] =
            if is_scaled { [factor / of_file[0], offset - factor * of_file[1] / of_file[0]] } else { [factor, offset] };
        let units = if of_file == [1.0, 0.0] || is_scaled { own_units } else { [1.0, 0.0] };
        let mut scale = [factor * units[0], offset * units[0] + units[1]];
        if is_tiff {
            let factor = options.height_scale.unwrap_or(1.0);
            scale = [scale[0] * factor, scale[1] * factor + options.height_offset];
        }
        let scaled = Scaled { file: opened.reader, scale };
        let image = Arc::new(PixelImage::new(opened.grid, Box::new(scaled), &context.cache));
        Ok((Piece { image, from, to }, wider))
    };
    let pieces: Result<Pieces, GenError> = raster.bands[number - 1].sources.par_iter().map(piece).collect();
    let pieces = pieces?;
    Ok((raster, pieces))
}

/// The heights of a file in the units of a virtual raster.
struct Scaled {
    file: Box<dyn BlockReader>,
    /// The factor, and the offset in metres.
    scale: [f64; 2],
}

impl BlockReader for Scaled {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let mut pixels = self.file.read(block)?;
        let [factor, offset] = self.scale;
        if self.scale != [1.0, 0.0] {
            for pixel in &mut pixels {
                *pixel = ((f64::from(f32::from_bits(*pixel)) * factor + offset) as f32).to_bits();
            }
        }
        Ok(pixels)
    }

    fn is_known_empty(&self, block: Rect) -> bool {
        self.file.is_known_empty(block)
    }
}
