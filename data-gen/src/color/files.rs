//! Opens imagery: GeoTIFFs with their overviews, web tiles with their zoom levels, JPEG 2000, virtual rasters, and photographs with
//! a world file.

use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::levels::{Level, Opened};
use super::{jpeg2000, tiles, virtual_raster};
use crate::GenError;
use crate::elevation::png_rows;
use crate::georeference::{Crs, Placement, geotiff::Tiff};
use crate::jpeg2000::is_jpeg2000;
use crate::store::{BlockCache, BlockReader, FileState, PixelImage, Rect, WholeReader, first_bytes, is_remote, whole};
use crate::virtual_raster::is_virtual;
use crate::web_tiles::is_archive;

/// The bytes of decoded tiles that the reader of a TIFF keeps: those of one block are read once for each channel.
const TIFF_CACHE_BYTES: usize = 8 << 20;

/// Opens an image file, a folder of web tiles, or an archive of them. `given` is the reference system of files that do not
/// name their own.
pub(super) fn open(path: &Path, given: Option<Crs>, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    open_at(path, given, cache, 0)
}

/// Like [`open`], for a file inside of `depth` virtual rasters.
fn open_at(path: &Path, given: Option<Crs>, cache: &Arc<BlockCache>, depth: usize) -> Result<Opened, GenError> {
    if is_archive(path, cache)? {
        return tiles::open(path, cache);
    }
    let name = path.to_string_lossy();
    let name = if is_remote(path) { name.split(['?', '#']).next().unwrap_or_default() } else { &*name };
    let extension = Path::new(name).extension();
    if extension.is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff")) {
        return open_tiff(path, given, cache);
    }
    if is_remote(path) {
        return Err(GenError::invalid(
            path,
            "neither .tif nor .pmtiles; files of other formats are read from disks only",
        ));
    }
    let magic = first_bytes(path, cache)?;
    if is_jpeg2000(&magic) {
        return jpeg2000::open(path, given, cache);
    }
    if is_virtual(path, &magic) {
        let open = |path: &Path, given| open_at(path, given, cache, depth + 1);
        return virtual_raster::open(path, given, cache, depth, &open);
    }
    GenError::if_not_regular(path)?;
    // The format is recognised by the content, because extensions may be wrong.
    let reader = image::ImageReader::open(path).and_then(|r| r.with_guessed_format());
    let reader = reader.map_err(GenError::file(path))?;
    let is_png = reader.format() == Some(image::ImageFormat::Png);
    let size = reader.into_dimensions().map_err(|e| GenError::invalid(path, e.to_string()))?;
    let size = [size.0 as usize, size.1 as usize];
    let placement = Placement::of_image(path, size, given, cache)?.unwrap_or_default();
    let file = Photo { path: path.to_owned(), is_png, state: FileState::of(path)? };
    let (grid, reader) = whole(Box::new(file), size, cache);
    Ok(Opened { levels: vec![Level::finest(PixelImage::new(grid, reader, cache))], placement })
}

/// Opens a GeoTIFF, and its overviews that can be read by blocks.
fn open_tiff(path: &Path, given: Option<Crs>, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let t = Tiff::open_caching(path, TIFF_CACHE_BYTES, cache)?;
    let placement = Placement::of_tiff(path, &t, given, cache)?.unwrap_or_default();
    let size = [t.width, t.height];
    let overview = |overview: Tiff| {
        let own = [overview.width, overview.height];
        let image = PixelImage::new(overview.grid(false)?, Box::new(TiffImage { tiff: overview }), cache);
        let scale = [0, 1].map(|axis| own[axis] as f64 / size[axis] as f64);
        Some(Level { image: Arc::new(image), scale, origin: [0.0; 2] })
    };
    let overviews: Vec<Level> = t.overviews()?.into_iter().filter_map(overview).collect();
    let (grid, reader): (_, Box<dyn BlockReader>) = match t.grid(false) {
        Some(grid) => (grid, Box::new(TiffImage { tiff: t })),
        None => whole(Box::new(WholeTiff { path: path.to_owned(), cache: Arc::clone(cache) }), size, cache),
    };
    let mut levels = vec![Level::finest(PixelImage::new(grid, reader, cache))];
    levels.extend(overviews);
    Ok(Opened { levels, placement })
}

/// A GeoTIFF, read by blocks.
struct TiffImage {
    tiff: Tiff,
}

impl BlockReader for TiffImage {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        Ok(self.tiff.rgba(block)?.into_iter().map(u32::from_ne_bytes).collect())
    }
}

/// A GeoTIFF with a tile or strip that is too large to be a block.
struct WholeTiff {
    path: PathBuf,
    cache: Arc<BlockCache>,
}

impl WholeReader for WholeTiff {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let bytes = Tiff::open(&self.path, &self.cache)?.row_bytes();
        let tiff = Tiff::open_caching(&self.path, bytes, &self.cache)?;
        for step in tiff.row_steps() {
            let pixels: Vec<u32> = tiff.rgba(step)?.into_iter().map(u32::from_ne_bytes).collect();
            call(&pixels)?;
        }
        Ok(())
    }

    fn path(&self) -> &Path {
        &self.path
    }
}

/// A PNG, JPEG or WebP file.
struct Photo {
    path: PathBuf,
    is_png: bool,
    state: FileState,
}

impl WholeReader for Photo {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        self.state.check(&self.path)?;
        if self.is_png {
            let file = std::fs::File::open(&self.path).map_err(GenError::file(&self.path))?;
            return png_rows(BufReader::new(file), &self.path, &mut |row, color, depth| call(&rgba(row, color, depth)));
        }
        let reader = image::ImageReader::open(&self.path).and_then(|r| r.with_guessed_format());
        let image = reader.map_err(GenError::file(&self.path))?.decode();
        let image = image.map_err(|e| GenError::invalid(&self.path, e.to_string()))?.into_rgba8();
        let pixels: Vec<u32> = image.as_raw().as_chunks().0.iter().map(|pixel| u32::from_ne_bytes(*pixel)).collect();
        call(&pixels)
    }

    fn path(&self) -> &Path {
        &self.path
    }
}

/// Returns the pixels of a PNG's row.
fn rgba(row: &[u8], color: png::ColorType, depth: png::BitDepth) -> Vec<u32> {
    let (channels, bytes) = (color.samples(), if depth == png::BitDepth::Sixteen { 2 } else { 1 });
    let value = |pixel: &[u8], channel: usize| match bytes {
        1 => pixel[channel],
        _ => ((u32::from(u16::from_be_bytes([pixel[2 * channel], pixel[2 * channel + 1]])) + 128) / 257) as u8,
    };
    let pixels = row.chunks_exact(channels * bytes).map(|pixel| {
        let (r, last) = (value(pixel, 0), value(pixel, channels - 1));
        match channels {
            1 => [r, r, r, 255],
            2 => [r, r, r, last],
            3 => [r, value(pixel, 1), last, 255],
            _ => [r, value(pixel, 1), value(pixel, 2), last],
        }
    });
    pixels.map(u32::from_ne_bytes).collect()
}
