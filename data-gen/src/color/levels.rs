//! The levels of an image: the image itself, the overviews that its file has, and averages where overviews are missing.

use std::sync::{Arc, Mutex, PoisonError};

use crate::GenError;
use crate::georeference::Placement;
use crate::store::{BlockCache, BlockGrid, BlockReader, Cursor, PixelImage, Rect, SpillPart, first_pixel};

/// The side of the blocks of averages.
const BLOCK: usize = 256;
/// A level is at least this much coarser than the one before, and at most so much. Averages fill wider gaps.
const STEPS: std::ops::RangeInclusive<f64> = 1.33..=2.9;

/// An image, or a smaller copy of it.
pub(super) struct Level {
    pub image: Arc<PixelImage>,
    /// The width and height of the finest level's pixels in pixels of this one.
    pub scale: [f64; 2],
    /// The column and row of the finest level's north-western corner.
    pub origin: [f64; 2],
}

/// An image whose header was read.
pub(super) struct Opened {
    /// The image and the smaller copies that the file has, finest first.
    pub levels: Vec<Level>,
    pub placement: Placement,
}

impl Level {
    /// Creates the finest level.
    pub fn finest(image: PixelImage) -> Self {
        Self { image: Arc::new(image), scale: [1.0; 2], origin: [0.0; 2] }
    }

    /// Returns how many pixels of the finest level a pixel of this one is as wide as.
    pub fn coarseness(&self) -> f64 {
        (self.scale[0] * self.scale[1]).sqrt().recip()
    }
}

/// Returns the levels that a file has, finest first, with averages where the next one is missing. The last level is a single
/// pixel.
pub(super) fn completed(own: Vec<Level>, cache: &Arc<BlockCache>) -> Vec<Level> {
    let mut own = own.into_iter().peekable();
    let mut levels: Vec<Level> = own.next().into_iter().collect();
    while let Some(last) = levels.last() {
        let step = |level: &Level| level.coarseness() / last.coarseness();
        while own.next_if(|level| step(level) < *STEPS.start()).is_some() {}
        let Some(next) = own.next_if(|level| step(level) <= *STEPS.end()).or_else(|| halved(last, cache)) else {
            break;
        };
        levels.push(next);
    }
    levels
}

/// Returns a level at half the resolution. `None` if it is a single pixel.
fn halved(level: &Level, cache: &Arc<BlockCache>) -> Option<Level> {
    let finer = &level.image;
    let size = finer.grid().size;
    if size == [1, 1] {
        return None;
    }
    let grid = BlockGrid::new(size.map(|side| side.div_ceil(2)), [BLOCK; 2]);
    let stored = Stored { part: None, is_stored: Vec::new() };
    let half = Half { finer: Arc::clone(finer), grid, cache: Arc::clone(cache), stored: Mutex::new(stored) };
    let image = Arc::new(PixelImage::new(grid, Box::new(half), cache));
    Some(Level { image, scale: level.scale.map(|s| 0.5 * s), origin: level.origin.map(|at| 0.5 * at) })
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
