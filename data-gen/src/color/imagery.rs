//! Imagery files: RGBA images with a position on the earth, read by blocks, and smaller copies of them for coarse tiles.

use std::f64::consts::TAU;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::GenError;
use crate::elevation::png_rows;
use crate::georeference::{Crs, Placement, geotiff::Tiff};
use crate::pyramid::Extent;
use crate::store::{BlockCache, BlockGrid, BlockReader, Cursor, FileState, PixelImage, Rect, SpillPart, WholeReader};
use crate::store::{first_pixel, whole};

/// Offsets to try for a longitude, in radians: imagery of the whole world may span 0 to 360 degrees.
const TURNS: [f64; 3] = [0.0, TAU, -TAU];
/// The side of the blocks of smaller copies.
const BLOCK: usize = 256;
/// The bytes of decoded tiles that the reader of a TIFF keeps: those of one block are read once for each channel.
const TIFF_CACHE_BYTES: usize = 8 << 20;

/// Images in the order of their priority. Where an image is transparent, the next one is seen.
pub(crate) struct Imagery {
    images: Vec<Image>,
}

/// An image with its position on the earth.
struct Image {
    /// The image, and copies of it, each half as fine as the one before.
    levels: Vec<Arc<PixelImage>>,
    placement: Placement,
}

impl Imagery {
    /// Opens image files. `given` is the reference system of files that do not name their own. Pixels with the nodata value of
    /// a file, and those that its mask hides, are transparent.
    pub fn open(paths: &[PathBuf], given: Option<&Crs>, cache: &Arc<BlockCache>) -> Result<Self, GenError> {
        let images = paths.iter().map(|path| Image::open(path, given.cloned(), cache));
        Ok(Self { images: images.collect::<Result<_, _>>()? })
    }

    /// Returns true if an image overlaps `extent`. A grid of points of each is searched in the other.
    pub fn covers(&self, extent: &Extent) -> Result<bool, GenError> {
        for image in &self.images {
            if image.covers(extent)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Returns the size of the smallest pixel at the centre of an image, in radians of longitude and latitude.
    pub fn pixel_size(&self) -> [f64; 2] {
        let sizes = self.images.iter().map(Image::pixel_size);
        sizes.fold([f64::INFINITY; 2], |a, b| [a[0].min(b[0]), a[1].min(b[1])])
    }

    /// Returns a sampler for texels of a size in radians inside `extent`, on one thread.
    pub fn sampler(&self, extent: &Extent, texel: [f64; 2]) -> ImagerySampler<'_> {
        let layer = |image: &'_ Image| image.level(extent, texel);
        let layers = self.images.iter().map(|image| {
            let level = layer(image);
            (image, level, Cursor::new(&image.levels[level]))
        });
        ImagerySampler { layers: layers.collect() }
    }
}

/// Samples imagery for one tile.
pub(crate) struct ImagerySampler<'a> {
    /// Each image with the level that is sampled.
    layers: Vec<(&'a Image, usize, Cursor<'a>)>,
}

impl ImagerySampler<'_> {
    /// Returns the colour at a longitude and latitude in radians: sRGB, 0..255, and the opacity, 0..1. They are interpolated
    /// between the pixels that are not transparent. `None` outside of the images, and where the nearest pixels are
    /// transparent.
    pub fn at(&mut self, longitude: f64, latitude: f64) -> Result<Option<[f64; 4]>, GenError> {
        // The colours above, multiplied by their opacity.
        let mut above = [0.0; 4];
        for (image, level, cursor) in &mut self.layers {
            let Some([r, g, b, opacity]) = image.at(cursor, longitude, latitude, *level)? else { continue };
            let seen = (1.0 - above[3]) * opacity;
            above = [above[0] + seen * r, above[1] + seen * g, above[2] + seen * b, above[3] + seen];
            if above[3] >= 1.0 {
                break;
            }
        }
        let [r, g, b, opacity] = above;
        Ok((opacity > 0.0).then(|| [r / opacity, g / opacity, b / opacity, opacity]))
    }
}

impl Image {
    fn open(path: &Path, given: Option<Crs>, cache: &Arc<BlockCache>) -> Result<Self, GenError> {
        GenError::if_not_regular(path)?;
        let is_tiff = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"));
        let (grid, reader, placement) = if is_tiff {
            let t = Arc::new(Tiff::open_caching(path, TIFF_CACHE_BYTES)?);
            let placement = Placement::of_tiff(path, &t, given)?.unwrap_or_default();
            let (grid, reader): (_, Box<dyn BlockReader>) = match t.grid(false) {
                Some(grid) => (grid, Box::new(TiffImage { tiff: t })),
                None => whole(Box::new(WholeTiff { path: path.to_owned() }), [t.width, t.height], cache),
            };
            (grid, reader, placement)
        } else {
            // The format is recognised by the content, because extensions may be wrong.
            let reader = image::ImageReader::open(path).and_then(|r| r.with_guessed_format());
            let reader = reader.map_err(GenError::file(path))?;
            let is_png = reader.format() == Some(image::ImageFormat::Png);
            let size = reader.into_dimensions().map_err(|e| GenError::invalid(path, e.to_string()))?;
            let size = [size.0 as usize, size.1 as usize];
            let placement = Placement::of_image(path, size, given)?;
            let file = Photo { path: path.to_owned(), is_png, state: FileState::of(path)? };
            let (grid, reader) = whole(Box::new(file), size, cache);
            (grid, reader, placement)
        };
        let mut levels = vec![Arc::new(PixelImage::new(grid, reader, cache))];
        while let Some(coarser) = levels.last().and_then(|finer| halved(finer, cache)) {
            levels.push(Arc::new(coarser));
        }
        Ok(Self { levels, placement })
    }

    fn covers(&self, extent: &Extent) -> Result<bool, GenError> {
        let grid = (0..=32).flat_map(|j| (0..=32).map(move |i| [f64::from(i) / 32.0, f64::from(j) / 32.0]));
        let [width, height] = self.size();
        let mut cursor = Cursor::new(&self.levels[0]);
        for [s, t] in grid {
            let longitude = extent.west + s * (extent.east - extent.west);
            let latitude = extent.south + t * (extent.north - extent.south);
            let [lon, lat] = self.placement.longitude_latitude(s * width, t * height);
            let is_within = |turn: &f64| (extent.west..=extent.east).contains(&(lon + turn));
            let inside = TURNS.iter().any(is_within) && (extent.south..=extent.north).contains(&lat);
            if inside || self.at(&mut cursor, longitude, latitude, 0)?.is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn pixel_size(&self) -> [f64; 2] {
        let [width, height] = self.size();
        let at = |dx: f64, dy: f64| self.placement.longitude_latitude(0.5 * width + dx, 0.5 * height + dy);
        let [a, b, c] = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)];
        [0, 1].map(|k| (b[k] - a[k]).hypot(c[k] - a[k]))
    }

    /// Returns the level for texels of a size in radians around the middle of `extent`: the one whose pixels are about as
    /// large.
    fn level(&self, extent: &Extent, texel: [f64; 2]) -> usize {
        let (longitude, latitude) = (0.5 * (extent.west + extent.east), 0.5 * (extent.south + extent.north));
        let at = |longitude: f64, latitude: f64| self.placement.pixel(longitude, latitude);
        let around = [at(longitude, latitude), at(longitude + texel[0], latitude), at(longitude, latitude + texel[1])];
        let [Some(a), Some(b), Some(c)] = around else { return 0 };
        let pixels = [b, c].map(|p| (p[0] - a[0]).hypot(p[1] - a[1])).into_iter().fold(1.0, f64::max);
        (pixels.log2().round() as usize).min(self.levels.len() - 1)
    }

    /// Returns the colour at a longitude and latitude in radians of a level whose cursor is given.
    fn at(
        &self,
        cursor: &mut Cursor<'_>,
        longitude: f64,
        latitude: f64,
        level: usize,
    ) -> Result<Option<[f64; 4]>, GenError> {
        let [w, h] = self.size();
        let is_inside = |[c, r]: &[f64; 2]| (0.0..=w).contains(c) && (0.0..=h).contains(r);
        let mut found = TURNS.iter().filter_map(|turn| self.placement.pixel(longitude + turn, latitude));
        let Some([c, r]) = found.find(is_inside) else { return Ok(None) };
        let scale = 1.0 / (1u64 << level) as f64;
        interpolate(cursor, self.levels[level].grid().size, c * scale, r * scale)
    }

    /// Returns the width and height in pixels.
    fn size(&self) -> [f64; 2] {
        self.levels[0].grid().size.map(|side| side as f64)
    }
}

/// Interpolates at a column and row; whole numbers are pixel corners.
fn interpolate(
    cursor: &mut Cursor<'_>,
    [width, height]: [usize; 2],
    column: f64,
    row: f64,
) -> Result<Option<[f64; 4]>, GenError> {
    let (w, h) = (width as f64, height as f64);
    let (x, y) = ((column - 0.5).clamp(0.0, w - 1.0), (row - 0.5).clamp(0.0, h - 1.0));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = (x - x0 as f64, y - y0 as f64);
    let pixels = cursor.corners([x0, x1], [y0, y1])?.map(u32::to_ne_bytes);
    let nearest = pixels[usize::from(fx >= 0.5) + 2 * usize::from(fy >= 0.5)];
    if nearest[3] == 0 {
        return Ok(None);
    }
    let shares = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    let (mut color, mut opacity, mut weights) = ([0.0; 3], 0.0, 0.0);
    for (pixel, share) in pixels.into_iter().zip(shares) {
        let [r, g, b, alpha] = pixel.map(f64::from);
        if alpha > 0.0 {
            weights += share;
            opacity += share * alpha;
            for (sum, c) in color.iter_mut().zip([r, g, b]) {
                *sum += share * alpha * c;
            }
        }
    }
    let [r, g, b] = color.map(|c| c / opacity);
    Ok(Some([r, g, b, opacity / (255.0 * weights)]))
}

/// Returns an image at half the resolution. `None` if it is a single pixel.
fn halved(finer: &Arc<PixelImage>, cache: &Arc<BlockCache>) -> Option<PixelImage> {
    let size = finer.grid().size;
    if size == [1, 1] {
        return None;
    }
    let grid = BlockGrid::new(size.map(|side| side.div_ceil(2)), [BLOCK; 2]);
    let stored = Stored { part: None, is_stored: Vec::new() };
    let half = Half { finer: Arc::clone(finer), grid, cache: Arc::clone(cache), stored: Mutex::new(stored) };
    Some(PixelImage::new(grid, Box::new(half), cache))
}

/// An image at half the resolution of another: averages of 2 x 2 pixels, weighted by their opacity. Each block is computed
/// once, and kept in the temporary file.
struct Half {
    finer: Arc<PixelImage>,
    grid: BlockGrid,
    cache: Arc<BlockCache>,
    /// Locked for moments only.
    stored: Mutex<Stored>,
}

/// The blocks in the temporary file.
struct Stored {
    part: Option<Arc<SpillPart>>,
    /// For each block, row-major, whether it is in the file.
    is_stored: Vec<bool>,
}

impl Half {
    /// Returns the part of the temporary file, and whether it has a block.
    fn stored(&self, index: usize) -> std::io::Result<(Arc<SpillPart>, bool)> {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        let part = match &stored.part {
            Some(part) => Arc::clone(part),
            None => {
                let part = Arc::new(self.cache.spill().part((self.grid.size[0] * self.grid.size[1]) as u64)?);
                let [across, down] = self.grid.blocks();
                stored.is_stored = vec![false; across * down];
                Arc::clone(stored.part.insert(part))
            }
        };
        Ok((part, stored.is_stored.get(index) == Some(&true)))
    }

    /// Computes a block from the finer image.
    fn average(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let [width, height] = self.finer.grid().size;
        let mut cursor = Cursor::new(&self.finer);
        let mut pixels = Vec::with_capacity(block.pixels());
        let first = 2 * block.column;
        let count = (2 * block.width).min(width - first);
        let mut lines: [Vec<u32>; 2] = Default::default();
        for y in block.row..block.row + block.height {
            for (dy, line) in lines.iter_mut().enumerate() {
                line.clear();
                if 2 * y + dy < height {
                    cursor.row(first, 2 * y + dy, count, |run| line.extend_from_slice(run))?;
                }
            }
            pixels.extend((0..block.width).map(|x| {
                let finer = lines.iter().flat_map(|line| line.iter().skip(2 * x).take(2));
                average(finer.map(|pixel| pixel.to_ne_bytes().map(u32::from)))
            }));
        }
        Ok(pixels)
    }
}

/// Returns the average of pixels, weighted by their opacity.
fn average(pixels: impl Iterator<Item = [u32; 4]>) -> u32 {
    let (mut color, mut opacity, mut count) = ([0u32; 3], 0, 0);
    for [r, g, b, alpha] in pixels {
        for (sum, c) in color.iter_mut().zip([r, g, b]) {
            *sum += alpha * c;
        }
        opacity += alpha;
        count += 1;
    }
    let [r, g, b] = color.map(|c| ((c + opacity / 2) / opacity.max(1)) as u8);
    u32::from_ne_bytes([r, g, b, ((opacity + count / 2) / count.max(1)) as u8])
}

impl BlockReader for Half {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let temporary = |reason| GenError::File { path: std::env::temp_dir(), reason };
        let index = self.grid.block_of(block.column, block.row).1 as usize;
        let (part, is_stored) = self.stored(index).map_err(temporary)?;
        let first = first_pixel(self.grid, block);
        if is_stored {
            return part.read(first, block.pixels()).map_err(temporary);
        }
        let pixels = self.average(block)?;
        part.write(first, &pixels).map_err(temporary)?;
        self.stored.lock().unwrap_or_else(PoisonError::into_inner).is_stored[index] = true;
        Ok(pixels)
    }
}

/// A GeoTIFF, read by blocks.
struct TiffImage {
    tiff: Arc<Tiff>,
}

impl BlockReader for TiffImage {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        Ok(self.tiff.rgba(block)?.into_iter().map(u32::from_ne_bytes).collect())
    }
}

/// A GeoTIFF with a tile or strip that is too large to be a block.
struct WholeTiff {
    path: PathBuf,
}

impl WholeReader for WholeTiff {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let bytes = Tiff::open(&self.path)?.row_bytes();
        let tiff = Tiff::open_caching(&self.path, bytes)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    fn open(path: &Path) -> Imagery {
        Imagery::open(&[path.to_owned()], None, &Arc::new(BlockCache::new(1 << 20))).unwrap()
    }

    /// Samples a level of the first image at a position in degrees.
    fn at_level(imagery: &Imagery, longitude: f64, latitude: f64, level: usize) -> Option<[f64; 4]> {
        let image = &imagery.images[0];
        let mut cursor = Cursor::new(&image.levels[level]);
        image.at(&mut cursor, longitude.to_radians(), latitude.to_radians(), level).unwrap()
    }

    #[test]
    fn blocks_of_smaller_copies_are_averages_and_are_computed_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large.png");
        // Larger than a block in memory, and not a multiple of the blocks' sides.
        let pixel = |x: u32, y: u32| image::Rgb([(x / 8) as u8, (y / 8) as u8, ((x + y) % 2 * 200) as u8]);
        image::RgbImage::from_fn(1030, 1100, pixel).save(&path).unwrap();
        // No block stays in the cache.
        let imagery = Imagery::open(&[path], None, &Arc::new(BlockCache::new(0))).unwrap();
        let levels = &imagery.images[0].levels;
        for _ in 0..2 {
            for (level, x, y) in [(1, 0, 0), (1, 514, 549), (1, 255, 256), (2, 100, 200), (3, 128, 137)] {
                let [r, g, b, alpha] = Cursor::new(&levels[level]).pixel(x, y).unwrap().to_ne_bytes();
                let expected = [(x << level) / 8, (y << level) / 8].map(|v| v as u8);
                assert_eq!(([r, g], b, alpha), (expected, 100, 255), "{level} {x} {y}");
            }
        }
    }

    #[test]
    fn images_below_are_seen_through_transparent_ones() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, pixel: [u8; 4], west: f64| {
            let path = folder.path().join(name);
            image::RgbaImage::from_pixel(2, 2, image::Rgba(pixel)).save(&path).unwrap();
            std::fs::write(path.with_extension("pgw"), format!("1\n0\n0\n-1\n{west}\n1.5\n")).unwrap();
            path
        };
        let paths = [write("above.png", [200, 0, 0, 51], 0.5), write("below.png", [0, 100, 0, 255], 1.5)];
        let imagery = Imagery::open(&paths, None, &Arc::new(BlockCache::new(1 << 20))).unwrap();
        let extent = Extent { west: 0.0, south: 0.0, east: 0.05, north: 0.03 };
        let mut sampler = imagery.sampler(&extent, [0.01; 2]);
        let mut at = |longitude: f64| sampler.at(longitude.to_radians(), 1f64.to_radians()).unwrap();
        assert_eq!(at(0.5), Some([200.0, 0.0, 0.0, 0.2]));
        let [r, g, b, opacity] = at(1.5).unwrap();
        assert!((r - 40.0).abs() < 1e-9 && (g - 80.0).abs() < 1e-9 && b == 0.0 && (opacity - 1.0).abs() < 1e-9);
        assert_eq!(at(2.5), Some([0.0, 100.0, 0.0, 1.0]));
        assert_eq!(at(3.5), None);
    }

    #[test]
    fn format_is_recognised_by_content() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["image", "image.jpg"] {
            let path = folder.path().join(name);
            image::RgbImage::from_pixel(4, 4, image::Rgb([10, 20, 30]))
                .save_with_format(&path, image::ImageFormat::Png)
                .unwrap();
            let imagery = open(&path);
            let mut cursor = Cursor::new(&imagery.images[0].levels[0]);
            assert_eq!(cursor.pixel(0, 0).unwrap().to_ne_bytes(), [10, 20, 30, 255], "{name}");
        }
    }

    #[test]
    fn transparent_pixels_have_no_color() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("half.png");
        // Transparent pixels are black here; they must not darken their neighbours.
        let half = |x: u32, _| image::Rgba(if x < 2 { [0; 4] } else { [10, 20, 30, 255] });
        image::RgbaImage::from_fn(4, 4, half).save(&path).unwrap();
        std::fs::write(path.with_extension("pgw"), "1\n0\n0\n-1\n0.5\n3.5\n").unwrap();
        let imagery = open(&path);
        let at = |longitude: f64| at_level(&imagery, longitude, 2.0, 0);
        assert_eq!([at(0.7), at(1.9), at(2.1), at(3.5)].map(|c| c.is_some()), [false, false, true, true]);
        for longitude in [2.1, 2.4, 2.5, 3.5] {
            let color = at(longitude).unwrap();
            assert_eq!(color[3], 1.0, "{longitude}");
            assert!(color.iter().zip([10.0, 20.0, 30.0]).all(|(c, e)| (c - e).abs() < 1e-9), "{longitude}: {color:?}");
        }
    }

    /// Regression: coarse tiles took single pixels of fine imagery.
    #[test]
    fn coarse_levels_are_averages_of_opaque_pixels() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checks.png");
        let check = |x: u32, y: u32| match (x / 4, (x + y) % 2) {
            (0, 0) => image::Rgba([200, 100, 0, 255]),
            (0, _) => image::Rgba([100, 0, 50, 255]),
            // Half of these pixels are transparent.
            (_, 0) => image::Rgba([80, 90, 70, 255]),
            _ => image::Rgba([0; 4]),
        };
        image::RgbaImage::from_fn(7, 7, check).save(&path).unwrap();
        std::fs::write(path.with_extension("pgw"), "1\n0\n0\n-1\n0.5\n6.5\n").unwrap();
        let imagery = open(&path);
        let image = &imagery.images[0];
        assert_eq!(image.levels.iter().map(|l| l.grid().size).collect::<Vec<_>>(), [[7, 7], [4, 4], [2, 2], [1, 1]]);
        let at = |longitude: f64| at_level(&imagery, longitude, 5.0, 1).unwrap();
        assert_eq!(at(1.0), [150.0, 50.0, 25.0, 1.0]);
        let [r, g, b, alpha] = at(5.0);
        assert_eq!([r, g, b], [80.0, 90.0, 70.0]);
        assert!((alpha - 0.5).abs() < 0.01, "{alpha}");
        // One pixel is 1 degree: tiles whose texels are 1.9 degrees wide take the level of 2 degrees.
        let extent = Extent { west: 0.0, south: 0.0, east: 7f64.to_radians(), north: 7f64.to_radians() };
        assert_eq!(
            [0.5, 1.1, 1.9, 4.2].map(|degrees: f64| image.level(&extent, [degrees.to_radians(); 2])),
            [0, 0, 1, 2]
        );
    }
}
