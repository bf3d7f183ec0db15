//! PNGs with elevation: heights in the colours of RGB, or in the values of grey pixels.

use std::io::{BufRead, BufReader, Seek};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use png::{BitDepth, ColorType, Decoder, Transformations};

use super::{HeightEncoding, MAX_SAMPLES_PER_BYTE, Opened, RasterOptions};
use crate::GenError;
use crate::georeference::{Metadata, Placement};
use crate::store::{BlockCache, FileState, WholeReader, whole};
use crate::web_tiles::tile_of;

/// A PNG file with heights.
struct PngFile {
    path: PathBuf,
    options: RasterOptions,
    state: FileState,
}

/// Opens a PNG. It is placed by a file beside it, or by its path if that ends like a web tile's, `z/x/y.png`.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let state = FileState::of(path)?;
    let reader = || Ok(BufReader::new(std::fs::File::open(path).map_err(GenError::file(path))?));
    let size = size(reader()?, path, options, state.bytes())?;
    let beside = Placement::of_image(path, size, options.crs.clone(), cache)?;
    let placement = beside.or_else(|| Some(tile_of(path)?.placement(size))).unwrap_or_default();
    let nodata = options.nodata.or(Metadata::beside(path, cache)?.nodata());
    let options = RasterOptions { nodata, ..options.clone() };
    let file = PngFile { path: path.to_owned(), options, state };
    let (grid, reader) = whole(Box::new(file), size, cache);
    Ok(Opened { grid, reader, placement })
}

impl WholeReader for PngFile {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        self.state.check(&self.path)?;
        let file = std::fs::File::open(&self.path).map_err(GenError::file(&self.path))?;
        heights(BufReader::new(file), &self.path, &self.options, call)
    }

    fn path(&self) -> &Path {
        &self.path
    }
}

/// Reads the size of a PNG of a number of bytes. A PNG whose pixels are not heights is refused.
pub(super) fn size(
    png: impl BufRead + Seek,
    path: &Path,
    options: &RasterOptions,
    bytes: u64,
) -> Result<[usize; 2], GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("PNG: {reason}"));
    let mut decoder = Decoder::new(png);
    let info = decoder.read_header_info().map_err(|e| bad(e.to_string()))?;
    let color = match info.color_type {
        ColorType::Grayscale => "grey",
        ColorType::Rgb => "RGB",
        ColorType::Indexed => "palette",
        ColorType::GrayscaleAlpha => "grey with alpha",
        ColorType::Rgba => "RGBA",
    };
    let bits = info.bit_depth as u8;
    let is_grey = options.height_scale.is_some() && matches!((bits, color), (8 | 16, "grey" | "grey with alpha"));
    if !is_grey && !matches!((bits, color), (8, "RGB" | "RGBA")) {
        let reason = format!(
            "PNG of {bits}-bit {color}: heights are read from 8-bit RGB or RGBA (see --encoding), and from grey with \
             --height-scale"
        );
        return Err(GenError::invalid(path, reason));
    }
    let (width, height) = (info.width, info.height);
    if u64::from(width) * u64::from(height) > bytes.saturating_mul(MAX_SAMPLES_PER_BYTE) {
        return Err(bad(format!("{width} x {height} pixels in {bytes} bytes")));
    }
    Ok([width as usize, height as usize])
}

/// Calls with the bits of the heights in metres, north row first; NaN for transparent pixels. RGB and RGBA have the encoding of
/// the options; grey pixels have their height scale.
pub(super) fn heights(
    png: impl BufRead + Seek,
    path: &Path,
    options: &RasterOptions,
    call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>,
) -> Result<(), GenError> {
    let mut heights: Vec<u32> = Vec::new();
    rows(png, path, &mut |row, color, depth| {
        heights.clear();
        let (channels, wide) = (color.samples(), depth == BitDepth::Sixteen);
        let value = |bytes: &[u8], k: usize| match wide {
            true => u16::from_be_bytes([bytes[2 * k], bytes[2 * k + 1]]),
            false => bytes[k].into(),
        };
        let is_opaque = |pixel: &[u8]| match color {
            ColorType::GrayscaleAlpha | ColorType::Rgba => value(pixel, channels - 1) > 0,
            _ => true,
        };
        let pixels = row.chunks_exact(channels * if wide { 2 } else { 1 });
        let found = pixels.map(|pixel| match color {
            _ if !is_opaque(pixel) => f32::NAN,
            ColorType::Grayscale | ColorType::GrayscaleAlpha => options.height_m(value(pixel, 0).into()),
            _ => {
                let [r, g, b] = [0, 1, 2].map(|k| f64::from(value(pixel, k)));
                let height_m = match options.encoding {
                    HeightEncoding::TerrainRgb => -10_000.0 + 0.1 * (r * 65536.0 + g * 256.0 + b),
                    HeightEncoding::Terrarium => r * 256.0 + g + b / 256.0 - 32768.0,
                };
                if options.nodata == Some(height_m) { f32::NAN } else { height_m as f32 }
            }
        });
        heights.extend(found.map(f32::to_bits));
        call(&heights)
    })
}

/// Is called with the bytes of each row of an image, and the colour type and the bits of its samples.
type RowCall<'a> = &'a mut dyn FnMut(&[u8], ColorType, BitDepth) -> Result<(), GenError>;

/// Calls with the bytes of each row of a PNG, palettes and transparent colours expanded.
pub(crate) fn rows(png: impl BufRead + Seek, path: &Path, call: RowCall<'_>) -> Result<(), GenError> {
    let bad = |e: &dyn std::fmt::Display| GenError::invalid(path, format!("PNG: {e}"));
    let mut decoder = Decoder::new(png);
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    let mut reader = decoder.read_info().map_err(|e| bad(&e))?;
    let (color, depth) = reader.output_color_type();
    if reader.info().interlaced {
        // The rows of an interlaced image are complete after its last pass.
        let bytes = reader.output_buffer_size().filter(|bytes| *bytes <= MAX_INTERLACED_BYTES);
        let bytes = bytes.ok_or_else(|| bad(&"an interlaced image of more than 1 GiB"))?;
        let mut image = vec![0; bytes];
        let info = reader.next_frame(&mut image).map_err(|e| bad(&e))?;
        return image.chunks_exact(info.line_size).try_for_each(|row| call(row, color, depth));
    }
    while let Some(row) = reader.next_row().map_err(|e| bad(&e))? {
        call(row.data(), color, depth)?;
    }
    Ok(())
}

/// The largest interlaced image in bytes, which is decoded in memory.
const MAX_INTERLACED_BYTES: usize = 1 << 30;
