//! Images that can only be decoded from their beginning to their end: one block, or blocks in a temporary file.

use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use super::cache::BlockCache;
use super::image::{BlockGrid, BlockReader, Rect};
use super::spill::{SpillFile, SpillPart};
use crate::GenError;

/// The pixels of the rows that a writer gathers before it writes their blocks.
const PIXELS_AT_ONCE: usize = 4 << 20;
/// The largest side of a block in a temporary file.
const BLOCK: usize = 256;
/// The largest number of pixels of an image that is one block in memory.
const MAX_BLOCK_PIXELS: usize = 1 << 20;

/// Returns the index of a block's first pixel in a part: all rows of blocks before it are whole, and so are all blocks before
/// it in its own row.
pub(crate) fn first_pixel(grid: BlockGrid, block: Rect) -> u64 {
    block.row as u64 * grid.size[0] as u64 + block.column as u64 * block.height as u64
}

/// Returns the grid of blocks for an image that is decoded as a whole. Blocks are squares; those of very wide images are lower,
/// since a row of them is held in memory.
fn spill_grid(size: [usize; 2]) -> BlockGrid {
    BlockGrid::new(size, [BLOCK, (PIXELS_AT_ONCE / size[0].max(1)).clamp(1, BLOCK)])
}

/// Takes the rows of an image from the first to the last.
struct SpillWriter {
    part: SpillPart,
    grid: BlockGrid,
    /// The rows of the next row of blocks.
    rows: Vec<u32>,
    /// The number of rows that are in the file.
    written: usize,
}

impl SpillWriter {
    /// Adds pixels after those before them. Those beyond the last row of the image are left out.
    fn add(&mut self, mut pixels: &[u32]) -> Result<(), GenError> {
        let full = self.grid.size[0] * self.grid.block[1];
        while !pixels.is_empty() {
            let (now, later) = pixels.split_at(pixels.len().min(full - self.rows.len()));
            self.rows.extend_from_slice(now);
            pixels = later;
            if self.rows.len() == full {
                self.write_blocks().map_err(temporary)?;
            }
        }
        Ok(())
    }

    /// Writes the blocks of the gathered rows.
    fn write_blocks(&mut self) -> std::io::Result<()> {
        let [width, height] = self.grid.size;
        let count = (self.rows.len() / width).min(height - self.written.min(height));
        let mut pixels = Vec::with_capacity(width * count);
        for x in (0..width).step_by(self.grid.block[0]) {
            let end = (x + self.grid.block[0]).min(width);
            for row in self.rows.chunks_exact(width).take(count) {
                pixels.extend_from_slice(&row[x..end]);
            }
        }
        self.part.write(self.written as u64 * width as u64, &pixels)?;
        self.written += self.rows.len() / width;
        self.rows.clear();
        Ok(())
    }

    /// Writes the last rows and returns the part of the file.
    fn finish(mut self) -> std::io::Result<SpillPart> {
        if !self.rows.is_empty() {
            self.write_blocks()?;
        }
        Ok(self.part)
    }
}

/// Decodes an image that cannot be decoded by blocks.
pub(crate) trait WholeReader: Send + Sync {
    /// Calls with all pixels, row-major from the first row on, any number at once.
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError>;

    /// Returns the file for error messages.
    fn path(&self) -> &Path;
}

/// Returns the blocks of an image of a size that cannot be decoded by blocks. A small image is one block. A larger one is
/// decoded into the temporary file of the cache when its first block is needed.
pub(crate) fn whole(
    reader: Box<dyn WholeReader>,
    size: [usize; 2],
    cache: &BlockCache,
) -> (BlockGrid, Box<dyn BlockReader>) {
    if size[0].saturating_mul(size[1]) <= MAX_BLOCK_PIXELS {
        return (BlockGrid::new(size, size), Box::new(OneBlock { whole: reader }));
    }
    let reader = SpillReader::new(reader, size, cache.spill());
    (reader.grid, Box::new(reader))
}

/// Returns the error for an image with another number of pixels than its size.
fn wrong_count(path: &Path, found: usize, [width, height]: [usize; 2]) -> GenError {
    GenError::invalid(path, format!("{found} samples for {width} x {height}"))
}

/// Reads an image as one block.
struct OneBlock {
    whole: Box<dyn WholeReader>,
}

impl BlockReader for OneBlock {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let mut pixels = Vec::with_capacity(block.pixels());
        let mut found = 0;
        self.whole.read_all(&mut |more| {
            found += more.len();
            pixels.extend_from_slice(&more[..more.len().min(block.pixels() - pixels.len())]);
            Ok(())
        })?;
        if found != block.pixels() {
            return Err(wrong_count(self.whole.path(), found, [block.width, block.height]));
        }
        Ok(pixels)
    }
}

/// Reads blocks of an image that is decoded as a whole when its first block is needed.
struct SpillReader {
    whole: Box<dyn WholeReader>,
    grid: BlockGrid,
    file: Arc<SpillFile>,
    decoded: OnceLock<SpillPart>,
    /// Locked while a thread decodes the image.
    is_decoding: Mutex<()>,
}

impl SpillReader {
    fn new(whole: Box<dyn WholeReader>, size: [usize; 2], file: &Arc<SpillFile>) -> Self {
        let grid = spill_grid(size);
        Self { whole, grid, file: Arc::clone(file), decoded: OnceLock::new(), is_decoding: Mutex::new(()) }
    }

    fn decoded(&self) -> Result<&SpillPart, GenError> {
        if let Some(decoded) = self.decoded.get() {
            return Ok(decoded);
        }
        let _is_decoding = self.is_decoding.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(decoded) = self.decoded.get() {
            return Ok(decoded);
        }
        let [width, height] = self.grid.size;
        let part = self.file.part(width as u64 * height as u64).map_err(temporary)?;
        let mut rows = SpillWriter { part, grid: self.grid, rows: Vec::new(), written: 0 };
        let mut found = 0;
        self.whole.read_all(&mut |pixels| {
            found += pixels.len();
            rows.add(pixels)
        })?;
        let part = rows.finish().map_err(temporary)?;
        if found != width * height {
            return Err(wrong_count(self.whole.path(), found, self.grid.size));
        }
        Ok(self.decoded.get_or_init(|| part))
    }
}

impl BlockReader for SpillReader {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        self.decoded()?.read(first_pixel(self.grid, block), block.pixels()).map_err(temporary)
    }
}

/// Returns the error of a temporary file.
fn temporary(reason: std::io::Error) -> GenError {
    GenError::File { path: std::env::temp_dir(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Rows {
        size: [usize; 2],
        missing: usize,
    }

    impl WholeReader for Rows {
        fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
            let [width, height] = self.size;
            let pixels: Vec<u32> = (0..width * (height - self.missing)).map(|k| self.pixel(k)).collect();
            // Calls with parts of rows.
            pixels.chunks(777).try_for_each(call)
        }

        fn path(&self) -> &Path {
            Path::new("rows")
        }
    }

    impl Rows {
        fn pixel(&self, index: usize) -> u32 {
            ((index % self.size[0]) * 10_000 + index / self.size[0]) as u32
        }
    }

    #[test]
    fn blocks_are_those_of_the_rows() {
        let cache = BlockCache::new(0);
        // Two small images, and two in the temporary file.
        for size in [[1, 1], [300, 700], [2000, 600], [100_000, 45]] {
            let (grid, reader) = whole(Box::new(Rows { size, missing: 0 }), size, &cache);
            assert_eq!(grid.blocks() == [1, 1], size[0] < 2000, "{size:?}");
            for rect in grid.rects().step_by(3) {
                let pixels = reader.read(rect).unwrap();
                assert_eq!(pixels.len(), rect.pixels());
                for k in [0, rect.width - 1, rect.pixels() / 2, rect.pixels() - 1] {
                    let (x, y) = (rect.column + k % rect.width, rect.row + k / rect.width);
                    assert_eq!(pixels[k], (x * 10_000 + y) as u32, "{size:?} {rect:?} {k}");
                }
            }
        }
        for (size, reason) in [([300, 7], "1800 samples for 300 x 7"), ([2000, 600], "1198000 samples for 2000 x 600")]
        {
            let (grid, reader) = whole(Box::new(Rows { size, missing: 1 }), size, &cache);
            let error = reader.read(grid.block_of(0, 0).0).unwrap_err();
            assert_eq!(error.to_string(), format!("rows: {reason}"));
        }
    }
}
