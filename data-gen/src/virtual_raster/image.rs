//! The pixels of a virtual raster.

use std::sync::Arc;

use crate::GenError;
use crate::store::{BlockGrid, BlockReader, Cursor, PixelImage, Rect};

/// The side of a block in pixels.
const BLOCK: usize = 512;
/// Rectangles whose sizes and fractions differ by less than this, in pixels, have the same pixels.
const TOLERANCE: f64 = 1e-3;

/// The meaning of pixels.
pub(crate) trait VirtualPixels: Send + Sync {
    /// The pixel where there is none.
    const NONE: u32;

    /// Returns false for a pixel that does not cover what lies below.
    fn is_some(pixel: u32) -> bool;

    /// Returns the pixel among four, north-west, north-east, south-west and south-east, at fractions of their distances east
    /// and south.
    fn between(corners: [u32; 4], fractions: [f64; 2]) -> u32;
}

/// A part of an image that fills a part of a virtual raster.
pub(crate) struct Piece {
    pub image: Arc<PixelImage>,
    /// Column, row, width and height in the image and in the virtual raster.
    pub from: [f64; 4],
    pub to: [f64; 4],
}

/// The image of a virtual raster: parts of other images, the last one on top.
pub(crate) struct VirtualImage<P> {
    pieces: Vec<Piece>,
    pixels: std::marker::PhantomData<P>,
}

impl<P: VirtualPixels> VirtualImage<P> {
    /// Creates an image of a size and its grid of blocks.
    pub fn new(size: [usize; 2], pieces: Vec<Piece>) -> (BlockGrid, Self) {
        (BlockGrid::new(size, [BLOCK; 2]), Self { pieces, pixels: std::marker::PhantomData })
    }
}

impl Piece {
    /// Returns the pixels of a block whose middles are in the piece.
    fn part_of(&self, block: Rect) -> Option<Rect> {
        let range = |start: usize, count: usize, axis: usize| {
            let first = (self.to[axis] - 0.5).ceil().max(start as f64);
            let end = (self.to[axis] + self.to[axis + 2] - 0.5).ceil().min((start + count) as f64);
            (first < end).then_some((first as usize, (end - first) as usize))
        };
        let ((column, width), (row, height)) =
            (range(block.column, block.width, 0)?, range(block.row, block.height, 1)?);
        Some(Rect { column, row, width, height })
    }

    /// Returns the column and row of the image, whole numbers for middles of pixels, at the middle of a virtual pixel.
    fn at(&self, pixel: usize, axis: usize) -> f64 {
        let share = (pixel as f64 + 0.5 - self.to[axis]) / self.to[axis + 2];
        self.from[axis] + share * self.from[axis + 2] - 0.5
    }

    /// Returns the column and row of the image that a virtual pixel is a copy of, if all are copies.
    fn copied(&self, part: Rect) -> Option<[usize; 2]> {
        let at = [self.at(part.column, 0), self.at(part.row, 1)];
        let is_copy = (0..2).all(|axis| {
            let is_same_size = (self.from[axis + 2] - self.to[axis + 2]).abs() < TOLERANCE;
            is_same_size && (at[axis] - at[axis].round()).abs() < TOLERANCE && at[axis] > -0.5
        });
        let start = at.map(|at| at.round().max(0.0) as usize);
        let size = self.image.grid().size;
        let is_inside = start[0] + part.width <= size[0] && start[1] + part.height <= size[1];
        (is_copy && is_inside).then_some(start)
    }

    /// Copies the pixels of a part into those of a block.
    fn copy<P: VirtualPixels>(
        &self,
        part: Rect,
        start: [usize; 2],
        block: Rect,
        pixels: &mut [u32],
    ) -> Result<(), GenError> {
        let mut cursor = Cursor::new(&self.image);
        for row in 0..part.height {
            let to = (part.row + row - block.row) * block.width + part.column - block.column;
            let mut to = pixels[to..to + part.width].iter_mut();
            cursor.row(start[0], start[1] + row, part.width, |run| {
                for (pixel, to) in run.iter().zip(&mut to) {
                    if P::is_some(*pixel) {
                        *to = *pixel;
                    }
                }
            })?;
        }
        Ok(())
    }

    /// Resamples the pixels of a part into those of a block. Pixels beyond the image are those at its edge.
    fn resample<P: VirtualPixels>(&self, part: Rect, block: Rect, pixels: &mut [u32]) -> Result<(), GenError> {
        let size = self.image.grid().size;
        let mut cursor = Cursor::new(&self.image);
        let around = |at: f64, axis: usize| {
            let last = (size[axis] - 1) as f64;
            let at = at.clamp(0.0, last);
            let first = at.floor();
            ([first as usize, (first + 1.0).min(last) as usize], at - first)
        };
        for row in part.row..part.row + part.height {
            let (rows, south) = around(self.at(row, 1), 1);
            for column in part.column..part.column + part.width {
                let (columns, east) = around(self.at(column, 0), 0);
                let pixel = P::between(cursor.corners(columns, rows)?, [east, south]);
                if P::is_some(pixel) {
                    pixels[(row - block.row) * block.width + column - block.column] = pixel;
                }
            }
        }
        Ok(())
    }
}

impl<P: VirtualPixels> BlockReader for VirtualImage<P> {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let mut pixels = vec![P::NONE; block.pixels()];
        for piece in &self.pieces {
            let Some(part) = piece.part_of(block) else { continue };
            match piece.copied(part) {
                Some(start) => piece.copy::<P>(part, start, block, &mut pixels)?,
                None => piece.resample::<P>(part, block, &mut pixels)?,
            }
        }
        Ok(pixels)
    }

    fn is_known_empty(&self, block: Rect) -> bool {
        self.pieces.iter().all(|piece| piece.part_of(block).is_none())
    }
}
