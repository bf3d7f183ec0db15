//! PNGs with elevation: heights in the colours of RGB, or in the values of grey pixels.

use std::io::{BufReader, Read as _};
use std::path::Path;

use super::super::raster::Raster;
use super::{HeightEncoding, RasterOptions, web_tiles};
use crate::GenError;
use crate::georeference::Placement;

/// Reads a PNG. It is placed by its world file, or by its path if that ends like a web tile's, `z/x/y.png`.
pub(super) fn read(path: &Path, options: &RasterOptions) -> Result<Raster, GenError> {
    let (size, samples) = heights(path, options)?;
    let placement = match web_tiles::tile_of(path).filter(|_| !Placement::has_world_file(path)) {
        Some(tile) => tile.placement(size),
        None => Placement::of_image(path, size, options.crs.clone())?,
    };
    Ok(Raster::new(size, samples, placement))
}

/// Reads the size and the heights in metres, north row first; NaN for transparent pixels. RGB and RGBA have the encoding of
/// the options; grey pixels need a height scale. PNGs of other kinds hold something else and are refused.
pub(super) fn heights(path: &Path, options: &RasterOptions) -> Result<([usize; 2], Vec<f32>), GenError> {
    let kind = kind(path)?.unwrap_or((8, "RGB"));
    let is_grey = matches!(kind, (8 | 16, "grey" | "grey with alpha")) && options.height_scale.is_some();
    if !is_grey && !matches!(kind, (8, "RGB" | "RGBA")) {
        let (bits, color) = kind;
        let reason = format!(
            "PNG of {bits}-bit {color}: heights are read from 8-bit RGB or RGBA (see --encoding), and from grey with \
             --height-scale"
        );
        return Err(GenError::invalid(path, reason));
    }
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let reader = image::ImageReader::with_format(BufReader::new(file), image::ImageFormat::Png);
    let image = reader.decode().map_err(|e| GenError::invalid(path, format!("PNG: {e}")))?;
    let size = [image.width() as usize, image.height() as usize];
    if is_grey {
        let (is_wide, image) = (kind.0 == 16, image.into_luma_alpha16());
        let samples = image.pixels().map(|p| match p.0 {
            [_, 0] => f32::NAN,
            // 8-bit values were widened by the factor 257.
            [v, _] => options.height_m(f32::from(if is_wide { v } else { v / 257 })),
        });
        return Ok((size, samples.collect()));
    }
    let height_m = match options.encoding {
        HeightEncoding::TerrainRgb => |[r, g, b]: [f64; 3]| -10_000.0 + 0.1 * (r * 65536.0 + g * 256.0 + b),
        HeightEncoding::Terrarium => |[r, g, b]: [f64; 3]| r * 256.0 + g + b / 256.0 - 32768.0,
    };
    let image = image.into_rgba8();
    let samples = image.pixels().map(|p| match p.0 {
        [.., 0] => f32::NAN,
        [r, g, b, _] => {
            let height_m = height_m([r, g, b].map(f64::from));
            if options.nodata == Some(height_m) { f32::NAN } else { height_m as f32 }
        }
    });
    Ok((size, samples.collect()))
}

/// Returns the bits of a sample (of a palette index, if there is a palette) and the colour type from the IHDR chunk,
/// which is always the first. `None` if the file is too short. The decoder reports the format after its conversion, so
/// the chunk is read here.
fn kind(path: &Path) -> Result<Option<(u8, &'static str)>, GenError> {
    let mut header = Vec::new();
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    file.take(26).read_to_end(&mut header).map_err(GenError::file(path))?;
    let Some(&[bits, color]) = header.get(24..26) else { return Ok(None) };
    let color = match color {
        0 => "grey",
        2 => "RGB",
        3 => "palette",
        4 => "grey with alpha",
        6 => "RGBA",
        _ => "unknown colour type",
    };
    Ok(Some((bits, color)))
}
