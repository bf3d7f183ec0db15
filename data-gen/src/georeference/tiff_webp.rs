//! Colours of TIFFs whose tiles or strips are WebP images. GDAL writes those without transparent pixels as RGB, also in files
//! with opacity, which the crate `tiff-reader` refuses.

use std::io::Cursor;

use image::codecs::webp::WebPDecoder;
use image::{DynamicImage, ImageDecoder as _};

use super::geotiff::{Tiff, failed};
use crate::GenError;
use crate::store::Rect;

/// TIFF's code of the compression.
const WEBP: u16 = 50001;
/// The largest compressed tile or strip in bytes.
const MAX_BYTES: u64 = 64 << 20;

impl Tiff {
    /// Reads a rectangle as RGBA, row-major, north row first; `None` for other compressions.
    pub(super) fn webp(&self, r: Rect) -> Result<Option<Vec<[u8; 4]>>, GenError> {
        let ifd = self.file.ifd(self.index).map_err(|e| failed(&self.path, e))?;
        if ifd.compression() != WEBP || self.layout.planar_configuration == 2 || !matches!(self.channels(), 3 | 4) {
            return Ok(None);
        }
        let (offsets, counts) = match ifd.is_tiled() {
            true => (ifd.tile_offsets(), ifd.tile_byte_counts()),
            false => (ifd.strip_offsets(), ifd.strip_byte_counts()),
        };
        let (offsets, counts) = (offsets.unwrap_or_default(), counts.unwrap_or_default());
        let [width, height] = self.block_size();
        let across = self.width.div_ceil(width);
        let mut pixels = vec![[0; 4]; r.pixels()];
        for y in r.row / height..(r.row + r.height).div_ceil(height) {
            for x in r.column / width..(r.column + r.width).div_ceil(width) {
                let (Some(offset), Some(count)) = (offsets.get(y * across + x), counts.get(y * across + x)) else {
                    return Err(self.bad(format!("no tile in column {x} and row {y}")));
                };
                if *offset == 0 || *count == 0 {
                    continue;
                }
                if *count > MAX_BYTES {
                    return Err(self.bad(format!("a tile of {count} bytes; {MAX_BYTES} are supported")));
                }
                let bytes = self.file.source().read_exact_at(*offset, *count as usize);
                let bytes = bytes.map_err(|e| failed(&self.path, e))?;
                let bad = |e: image::ImageError| self.bad(format!("WebP in column {x} and row {y}: {e}"));
                let decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(bad)?;
                let [own_width, own_height] =
                    [decoder.dimensions().0, decoder.dimensions().1].map(|side| side as usize);
                // A last strip has the rows that are left.
                let least = if ifd.is_tiled() { height } else { height.min(self.height - y * height) };
                if own_width != width || !(least..=height).contains(&own_height) {
                    let reason =
                        format!("a WebP image of {own_width} x {own_height} pixels; tiles have {width} x {height}");
                    return Err(self.bad(reason));
                }
                let image = DynamicImage::from_decoder(decoder).map_err(bad)?.into_rgba8();
                let rows = (y * height).max(r.row)..(y * height + own_height).min(r.row + r.height);
                let columns = (x * width).max(r.column)..((x + 1) * width).min(r.column + r.width);
                let own = image.as_raw().as_chunks::<4>().0;
                for row in rows {
                    let from = (row - y * height) * width + columns.start - x * width;
                    let to = (row - r.row) * r.width + columns.start - r.column;
                    pixels[to..to + columns.len()].copy_from_slice(&own[from..from + columns.len()]);
                }
            }
        }
        Ok(Some(pixels))
    }
}
