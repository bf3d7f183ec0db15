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
    let bad = |reason: String| GenError::invalid(path, format!("VRT: {reason}"));
    if depth >= MAX_DEPTH {
        return Err(bad(format!("more than {MAX_DEPTH} virtual rasters inside of one another, or a loop of them")));
    }
    let raster = VirtualRaster::open(path, &context.cache)?;
    let number = match (&options.channel, raster.bands.iter().filter(|band| !band.is_alpha).count()) {
        (None, 1) => 1,
        (None, count) => return Err(bad(format!("{count} bands; elevation has one channel, --channel N chooses it"))),
        (Some(name), _) => {
            let number = name.parse().ok().filter(|n| (1..=raster.bands.len()).contains(n));
            number.ok_or_else(|| bad(format!("--channel {name}: it has bands 1 to {}", raster.bands.len())))?
        }
    };
    let placement = Placement::of_virtual(path, &raster.metadata, raster.size, options.crs.clone(), &context.cache)?;
    let placement = placement.ok_or_else(|| GenError::invalid(path, "VRT: no georeference"))?;
    let nodata = raster.metadata.nodata_of(number);
    let own_units = raster.metadata.factor_and_offset_m(number).map_err(bad)?;
    let piece = |source: &VirtualSource| {
        let (channel, nodata) = (Some(source.band.to_string()), source.nodata.or(nodata).or(options.nodata));
        // The file's own georeference does not matter, and it need not have one.
        let crs = options.crs.clone().or(Some(Crs::Geographic));
        // Formats of one channel have no names for it.
        let magic = first_bytes(&source.path, &context.cache)?;
        let is_named = is_tiff(&magic) || source.band != 1;
        let options = RasterOptions { channel: channel.filter(|_| is_named), nodata, crs, ..options.clone() };
        let opened = open_at(&source.path, &options, context, depth + 1)?;
        // The units of the virtual raster are copies of the file's, or stand in for those that it lacks.
        let has_units = own_units != [1.0, 0.0]
            && is_tiff(&magic)
            && Tiff::open(&source.path, &context.cache)?.has_units(source.band - 1);
        let units = if has_units { [1.0, 0.0] } else { own_units };
        let [from, to] = source.rectangles(opened.grid.size, raster.size);
        let [factor, offset] = source.factor_and_offset;
        let scaled = Scaled { file: opened.reader, scale: [factor * units[0], offset * units[0] + units[1]] };
        Ok(Piece { image: Arc::new(PixelImage::new(opened.grid, Box::new(scaled), &context.cache)), from, to })
    };
    let pieces: Result<Vec<Piece>, GenError> = raster.bands[number - 1].sources.par_iter().map(piece).collect();
    let (grid, image) = VirtualImage::<Heights>::new(raster.size, pieces?);
    Ok(Opened { grid, reader: Box::new(image), placement })
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
