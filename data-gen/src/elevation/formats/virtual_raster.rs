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
use crate::virtual_raster::{
    MAX_DEPTH, Piece, VirtualImage, VirtualPixels, VirtualRaster, VirtualSource, Warp, WarpedImage, WarpedPixels,
};

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

impl WarpedPixels for Heights {
    fn values(pixel: u32) -> ([f64; 3], f64) {
        ([f32::from_bits(pixel).into(), 0.0, 0.0], 1.0)
    }

    fn pixel([height_m, ..]: [f64; 3], _opacity: f64) -> u32 {
        (height_m as f32).to_bits()
    }
}

/// Opens a virtual raster, which is inside of `depth` others, and the headers of its files.
pub(super) fn open(
    path: &Path,
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    depth: usize,
) -> Result<Opened, GenError> {
    let (raster, number) = band(path, options, context, depth)?;
    if let Some(warp) = &raster.warp {
        return open_warped(path, &raster, number, warp, options, context, depth);
    }
    let pieces = pieces(path, &raster, number, options, context, depth, None)?;
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
    let (raster, number) = band(path, options, context, 0)?;
    if raster.warp.is_some() {
        return Ok(None);
    }
    let pieces = pieces(path, &raster, number, options, context, 0, Some(factors))?;
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

/// Reads a virtual raster, which is inside of `depth` others, and returns the number of the band with heights.
fn band(
    path: &Path,
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    depth: usize,
) -> Result<(VirtualRaster, usize), GenError> {
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
    Ok((raster, number))
}

/// A file of a virtual raster, and the number of its band.
struct SourceFile<'a> {
    path: &'a Path,
    band: usize,
    /// The value of samples without data.
    nodata: Option<f64>,
    /// The number by which the virtual raster multiplies samples, and the one that it adds then.
    factor_and_offset: [f64; 2],
    /// The factor and the offset of the virtual raster's band, in metres.
    units: [f64; 2],
}

impl SourceFile<'_> {
    /// Opens the file inside of `depth` virtual rasters, or the coarsest overview that `coarser` allows for its size, and returns
    /// the size of the file itself.
    fn open(
        &self,
        options: &RasterOptions,
        context: &Arc<SourceContext>,
        depth: usize,
        coarser: impl Fn([usize; 2]) -> Option<[f64; 2]>,
    ) -> Result<(Opened, [usize; 2]), GenError> {
        // The file's own georeference does not matter, and it need not have one.
        let crs = options.crs.clone().or(Some(Crs::Geographic));
        // Formats of one channel have no names for it.
        let magic = first_bytes(self.path, &context.cache)?;
        let is_tiff = is_tiff(&magic);
        let channel = Some(self.band.to_string()).filter(|_| is_tiff || self.band != 1);
        let mut inner = RasterOptions { channel, nodata: self.nodata, crs, ..options.clone() };
        // The factor of the options is that of heights, which the virtual raster makes of a TIFF's samples.
        if is_tiff {
            (inner.height_scale, inner.height_offset) = (None, 0.0);
        }
        let mut opened = open_at(self.path, &inner, context, depth)?;
        let size = opened.grid.size;
        let of_file = match is_tiff {
            true => Tiff::open(self.path, &context.cache)?.units(self.band - 1),
            false => [1.0, 0.0],
        };
        if let Some(factors) = coarser(size)
            && let Some(overview) = super::open_overview(self.path, factors, &inner, context, &opened.placement)?
        {
            opened = overview;
        }
        let [factor, offset] = self.factor_and_offset;
        // A virtual raster scales the samples of a file, not its heights. Without a factor its units are copies of the file's,
        // or stand in for those that it lacks.
        let is_scaled = self.factor_and_offset != [1.0, 0.0];
        let [factor, offset] =
            if is_scaled { [factor / of_file[0], offset - factor * of_file[1] / of_file[0]] } else { [factor, offset] };
        let units = if of_file == [1.0, 0.0] || is_scaled { self.units } else { [1.0, 0.0] };
        let mut scale = [factor * units[0], offset * units[0] + units[1]];
        if is_tiff {
            let factor = options.height_scale.unwrap_or(1.0);
            scale = [scale[0] * factor, scale[1] * factor + options.height_offset];
        }
        let reader = Box::new(Scaled { file: opened.reader, scale });
        Ok((Opened { reader, ..opened }, size))
    }
}

/// Returns the pieces of a band. `coarser` is how coarse overviews may be.
fn pieces(
    path: &Path,
    raster: &VirtualRaster,
    number: usize,
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    depth: usize,
    coarser: Option<[f64; 2]>,
) -> Result<Pieces, GenError> {
    let nodata = raster.metadata.nodata_of(number);
    let units = raster.metadata.factor_and_offset_m(number).map_err(|reason| bad(path, reason))?;
    let piece = |source: &VirtualSource| {
        let file = SourceFile {
            path: &source.path,
            band: source.band,
            nodata: source.nodata.or(nodata).or(options.nodata),
            factor_and_offset: source.factor_and_offset,
            units,
        };
        // The pixels of a file may be smaller than those of the virtual raster.
        let coarser_there = |size: [usize; 2]| {
            let [from, to] = source.rectangles(size, raster.size);
            coarser.map(|coarser| [0, 1].map(|axis| coarser[axis] * from[axis + 2] / to[axis + 2]))
        };
        let (opened, size) = file.open(options, context, depth + 1, coarser_there)?;
        let [mut from, to] = source.rectangles(size, raster.size);
        let mut wider = [1.0; 2];
        if opened.grid.size != size {
            let share = [0, 1].map(|axis| opened.grid.size[axis] as f64 / size[axis] as f64);
            from = [0, 1, 2, 3].map(|k| from[k] * share[k % 2]);
            wider = [0, 1].map(|axis| to[axis + 2] / from[axis + 2]);
        }
        let image = Arc::new(PixelImage::new(opened.grid, opened.reader, &context.cache));
        Ok((Piece { image, from, to }, wider))
    };
    raster.bands[number - 1].sources.par_iter().map(piece).collect()
}

/// Opens a virtual raster that resamples a file.
fn open_warped(
    path: &Path,
    raster: &VirtualRaster,
    number: usize,
    warp: &Warp,
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    depth: usize,
) -> Result<Opened, GenError> {
    let band = warp.bands.iter().find(|(own, ..)| *own == number);
    let (_, band, nodata) = *band.ok_or_else(|| bad(path, format!("no BandMapping of band {number}")))?;
    let to = Placement::of_virtual(path, &raster.metadata, raster.size, options.crs.clone(), &context.cache)?;
    let to = to.ok_or_else(|| bad(path, "no georeference"))?;
    let units = raster.metadata.factor_and_offset_m(number).map_err(|reason| bad(path, reason))?;
    let nodata = nodata.or(options.nodata);
    let file = SourceFile { path: &warp.path, band, nodata, factor_and_offset: [1.0, 0.0], units };
    let (opened, size) = file.open(options, context, depth + 1, |_| None)?;
    let from = warp.placement(path, &to, size, options.crs.clone(), &context.cache)?;
    let image = Arc::new(PixelImage::new(opened.grid, opened.reader, &context.cache));
    let (grid, reader) = WarpedImage::<Heights>::new(image, raster.size, [from, to.clone()], warp.resampling);
    Ok(Opened { grid, reader: Box::new(reader), placement: to })
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
