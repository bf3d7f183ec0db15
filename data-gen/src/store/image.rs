//! An image as a grid of blocks, and the cursor that reads its pixels.

use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::cache::{Block, BlockCache, BlockKey};
use crate::GenError;

/// The number of blocks that a cursor holds: four meet at a corner, and rows of samples lie in two at most.
const HELD: usize = 4;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Rect {
    pub column: usize,
    pub row: usize,
    pub width: usize,
    pub height: usize,
}

impl Rect {
    /// Returns the number of pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Returns the index of a pixel in the rectangle, row-major; `None` outside.
    fn index(&self, column: usize, row: usize) -> Option<usize> {
        let (x, y) = (column.wrapping_sub(self.column), row.wrapping_sub(self.row));
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }
}

/// The size of an image and of its blocks in pixels. Blocks in the last column and row end at the image's edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BlockGrid {
    pub size: [usize; 2],
    pub block: [usize; 2],
}

impl BlockGrid {
    /// Creates a grid with blocks of at most a size.
    pub fn new(size: [usize; 2], block: [usize; 2]) -> Self {
        Self { size, block: [0, 1].map(|k| block[k].clamp(1, size[k].max(1))) }
    }

    /// Returns the number of columns and rows of blocks.
    pub fn blocks(&self) -> [usize; 2] {
        [0, 1].map(|k| self.size[k].div_ceil(self.block[k]))
    }

    /// Returns the rectangle of the block that contains a pixel, and the block's index.
    pub fn block_of(&self, column: usize, row: usize) -> (Rect, u64) {
        let [x, y] = [column / self.block[0], row / self.block[1]];
        let start = [x * self.block[0], y * self.block[1]];
        let [width, height] = [0, 1].map(|k| self.block[k].min(self.size[k].saturating_sub(start[k])));
        let index = y as u64 * self.blocks()[0] as u64 + x as u64;
        (Rect { column: start[0], row: start[1], width, height }, index)
    }

    /// Returns the rectangles of all blocks, row-major from the first row.
    pub fn rects(&self) -> impl Iterator<Item = Rect> + use<> {
        let (grid, [across, down]) = (*self, self.blocks());
        (0..down).flat_map(move |y| (0..across).map(move |x| grid.block_of(x * grid.block[0], y * grid.block[1]).0))
    }
}

/// Decodes the blocks of an image. Several threads call it at the same time, for different blocks.
pub(crate) trait BlockReader: Send + Sync {
    /// Decodes the pixels of a block, row-major.
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError>;

    /// Returns true if no pixel of a block has data, as far as this is known without decoding it.
    fn is_known_empty(&self, _block: Rect) -> bool {
        false
    }
}

/// An image whose blocks are decoded when they are needed.
pub(crate) struct PixelImage {
    grid: BlockGrid,
    reader: Box<dyn BlockReader>,
    cache: Arc<BlockCache>,
    /// Its number in the cache.
    number: u64,
}

impl PixelImage {
    pub fn new(grid: BlockGrid, reader: Box<dyn BlockReader>, cache: &Arc<BlockCache>) -> Self {
        Self { grid, reader, cache: Arc::clone(cache), number: cache.new_image() }
    }

    pub fn grid(&self) -> BlockGrid {
        self.grid
    }

    /// Returns the reader of the image's blocks.
    pub fn reader(&self) -> &dyn BlockReader {
        &*self.reader
    }

    /// Returns the pixels of the block that contains a pixel, and the block's rectangle.
    pub fn block(&self, column: usize, row: usize) -> Result<(Rect, Block), GenError> {
        let (rect, index) = self.grid.block_of(column, row);
        let key = BlockKey { image: self.number, index };
        let block = self.cache.block(key, || {
            let pixels = self.reader.read(rect)?;
            assert_eq!(pixels.len(), rect.pixels(), "a reader returns as many pixels as a block has");
            Ok(pixels)
        })?;
        Ok((rect, block))
    }
}

/// The number of blocks that are read ahead at the same time.
const AHEAD: usize = 16;
/// Larger numbers of blocks are not read ahead: samples of coarse levels lie in few of them.
const MAX_AHEAD: usize = 256;

impl PixelImage {
    /// Reads the blocks of a rectangle of pixels, several at the same time, as far as they fit into half of the cache. For
    /// images on servers, whose blocks would be asked for one after another. Blocks that cannot be read are left to who needs
    /// them.
    pub fn read_ahead(&self, columns: RangeInclusive<usize>, rows: RangeInclusive<usize>) {
        let ends = [(columns, 0), (rows, 1)].map(|(range, axis)| {
            let last = self.grid.size[axis].saturating_sub(1);
            [*range.start(), *range.end()].map(|c| c.min(last) / self.grid.block[axis])
        });
        let [[x0, x1], [y0, y1]] = ends;
        if x1 < x0 || y1 < y0 {
            return;
        }
        let (across, down) = (x1 - x0 + 1, y1 - y0 + 1);
        let block_bytes = 4 * self.grid.block[0] * self.grid.block[1];
        let count = across.saturating_mul(down);
        if !(2..=MAX_AHEAD).contains(&count) || count * block_bytes > self.cache.budget() / 2 {
            return;
        }
        let next = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..count.min(AHEAD) {
                scope.spawn(|| {
                    loop {
                        let k = next.fetch_add(1, Ordering::Relaxed);
                        if k >= count {
                            return;
                        }
                        let [x, y] = [x0 + k % across, y0 + k / across];
                        let [column, row] = [x * self.grid.block[0], y * self.grid.block[1]];
                        let is_empty = self.reader.is_known_empty(self.grid.block_of(column, row).0);
                        if !is_empty && self.block(column, row).is_err() {
                            return;
                        }
                    }
                });
            }
        });
    }
}

/// Reads pixels of one image on one thread. It holds the blocks that it read last, so that neighbouring pixels cost no
/// look-up in the cache.
pub(crate) struct Cursor<'a> {
    image: &'a PixelImage,
    held: [Option<(Rect, Block)>; HELD],
    /// The index of the block in `held` that is replaced next.
    oldest: usize,
}

impl<'a> Cursor<'a> {
    pub fn new(image: &'a PixelImage) -> Self {
        Self { image, held: [const { None }; HELD], oldest: 0 }
    }

    /// Returns the pixel at a column and row inside the image.
    pub fn pixel(&mut self, column: usize, row: usize) -> Result<u32, GenError> {
        let (rect, block) = self.block(column, row)?;
        Ok(rect.index(column, row).map_or(0, |index| block[index]))
    }

    /// Calls with the pixels of a row from a column on, in runs of pixels of one block, until `count` are read. The row and
    /// the columns are inside the image.
    pub fn row(
        &mut self,
        column: usize,
        row: usize,
        count: usize,
        mut call: impl FnMut(&[u32]),
    ) -> Result<(), GenError> {
        let (mut column, end) = (column, column + count);
        while column < end {
            let (rect, block) = self.block(column, row)?;
            let Some(first) = rect.index(column, row) else { return Ok(()) };
            let run = (rect.column + rect.width).min(end) - column;
            call(&block[first..first + run]);
            column += run;
        }
        Ok(())
    }

    /// Returns the pixels at the corners of a rectangle inside the image: (x0, y0), (x1, y0), (x0, y1) and (x1, y1).
    pub fn corners(&mut self, [x0, x1]: [usize; 2], [y0, y1]: [usize; 2]) -> Result<[u32; 4], GenError> {
        let (rect, block) = self.block(x0, y0)?;
        if let (Some(a), Some(d)) = (rect.index(x0, y0), rect.index(x1, y1)) {
            let (right, below) = (x1.wrapping_sub(x0), (y1.wrapping_sub(y0)).wrapping_mul(rect.width));
            return Ok([block[a], block[a.wrapping_add(right)], block[a.wrapping_add(below)], block[d]]);
        }
        Ok([self.pixel(x0, y0)?, self.pixel(x1, y0)?, self.pixel(x0, y1)?, self.pixel(x1, y1)?])
    }

    fn block(&mut self, column: usize, row: usize) -> Result<(Rect, &Block), GenError> {
        let holds = |held: &Option<(Rect, Block)>| held.as_ref().is_some_and(|(r, _)| r.index(column, row).is_some());
        let at = match self.held.iter().position(holds) {
            Some(at) => at,
            None => {
                let at = self.oldest;
                self.held[at] = Some(self.image.block(column, row)?);
                self.oldest = (at + 1) % HELD;
                at
            }
        };
        let (rect, block) = self.held[at].as_ref().expect("the block was found or stored");
        Ok((*rect, block))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gives each pixel the value 1000 * row + column.
    struct Numbered;

    impl BlockReader for Numbered {
        fn read(&self, r: Rect) -> Result<Vec<u32>, GenError> {
            let rows = r.row..r.row + r.height;
            Ok(rows.flat_map(|y| (r.column..r.column + r.width).map(move |x| (1000 * y + x) as u32)).collect())
        }
    }

    #[test]
    fn pixels_and_rows_are_those_of_the_image() {
        // Hardly any block stays in the cache.
        let cache = Arc::new(BlockCache::new(200));
        let image = PixelImage::new(BlockGrid::new([37, 21], [8, 5]), Box::new(Numbered), &cache);
        let mut cursor = Cursor::new(&image);
        for (x, y) in (0..37).flat_map(|x| (0..21).map(move |y| (x, y))) {
            assert_eq!(cursor.pixel(x, y).unwrap(), (1000 * y + x) as u32);
        }
        for (column, row, count) in [(0, 0, 37), (7, 4, 2), (8, 5, 8), (36, 20, 1), (3, 20, 0)] {
            let mut found = Vec::new();
            cursor.row(column, row, count, |run| found.extend_from_slice(run)).unwrap();
            let expected: Vec<u32> = (column..column + count).map(|x| (1000 * row + x) as u32).collect();
            assert_eq!(found, expected);
        }
        for (x, y) in [(0, 0), (7, 4), (8, 5), (36, 20), (7, 9)] {
            for (x1, y1) in [(x, y), ((x + 1).min(36), (y + 1).min(20)), (0, y)] {
                let at = |x: usize, y: usize| (1000 * y + x) as u32;
                let expected = [at(x, y), at(x1, y), at(x, y1), at(x1, y1)];
                assert_eq!(cursor.corners([x, x1], [y, y1]).unwrap(), expected);
            }
        }
        let rects: Vec<Rect> = image.grid().rects().collect();
        assert_eq!(rects.len(), 25);
        assert_eq!(rects.iter().map(Rect::pixels).sum::<usize>(), 37 * 21);
        assert_eq!(rects[24], Rect { column: 32, row: 20, width: 5, height: 1 });
    }
}
