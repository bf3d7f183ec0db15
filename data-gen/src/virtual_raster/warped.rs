//! The pixels of a warped virtual raster: those of its file at the longitude and latitude of each pixel. Threads of the run.

use std::marker::PhantomData;
use std::sync::Arc;

use super::image::VirtualPixels;
use super::warp::Resampling;
use crate::GenError;
use crate::georeference::Placement;
use crate::store::{BlockGrid, BlockReader, Cursor, PixelImage, Rect};

/// The side of a block in pixels.
const BLOCK: usize = 256;
/// The smallest sum of the weights of known pixels that make another one.
const MIN_WEIGHT: f64 = 1e-5;

/// Pixels that are interpolated by weights.
pub(crate) trait WarpedPixels: VirtualPixels {
    /// Returns the values of a pixel with data, and its opacity, 0 to 1.
    fn values(pixel: u32) -> ([f64; 3], f64);

    /// Returns the pixel of values and an opacity. The values may lie beyond those of pixels.
    fn pixel(values: [f64; 3], opacity: f64) -> u32;
}

/// A file in another grid.
pub(crate) struct WarpedImage<P> {
    image: Arc<PixelImage>,
    /// The placements of the file's pixels, and of those of the virtual raster.
    from: Placement,
    to: Placement,
    resampling: Resampling,
    pixels: PhantomData<P>,
}

/// A weighted sum of pixels.
#[derive(Default)]
struct Sum {
    /// The values, by the weights and the opacities.
    values: [f64; 3],
    opacity: f64,
    /// The weights of the pixels with data.
    weight: f64,
}

/// Returns the weights of four samples, at a fraction of the distance between the second and the third: cubic convolution with the
/// parameter -0.5 (Keys, 1981).
fn cubic(t: f64) -> [f64; 4] {
    [
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    ]
}

impl<P: WarpedPixels> WarpedImage<P> {
    /// Creates the image of a file in the grid of a virtual raster of a size, and its grid of blocks. `from` is the placement of the
    /// file's pixels, `to` that of the raster's.
    pub fn new(
        image: Arc<PixelImage>,
        size: [usize; 2],
        [from, to]: [Placement; 2],
        resampling: Resampling,
    ) -> (BlockGrid, Self) {
        (BlockGrid::new(size, [BLOCK; 2]), Self { image, from, to, resampling, pixels: PhantomData })
    }

    /// Returns the pixel at a column and row of the file, whose whole numbers are corners of pixels; none outside and where there
    /// are no data.
    fn pixel(&self, cursor: &mut Cursor<'_>, at: [f64; 2]) -> Result<u32, GenError> {
        let size = self.image.grid().size;
        let is_inside = (0..2).all(|axis| (0.0..size[axis] as f64).contains(&at[axis]));
        if !is_inside {
            return Ok(P::NONE);
        }
        let own = cursor.pixel(at[0] as usize, at[1] as usize)?;
        if self.resampling == Resampling::Nearest || !P::is_some(own) {
            return Ok(own);
        }
        let first = at.map(|at| (at - 0.5).floor());
        let part = [0, 1].map(|axis| at[axis] - 0.5 - first[axis]);
        if self.resampling == Resampling::Cubic {
            let sum = self.sum(cursor, first, part.map(cubic))?;
            // Beside an edge or a gap GDAL interpolates between four samples.
            if (sum.weight - 1.0).abs() < MIN_WEIGHT {
                return Ok(sum.pixel::<P>());
            }
        }
        Ok(self.sum(cursor, first, part.map(|t| [0.0, 1.0 - t, t, 0.0]))?.pixel::<P>())
    }

    /// Returns the weighted sum of the pixels around a position, from one before `first` on.
    fn sum(&self, cursor: &mut Cursor<'_>, first: [f64; 2], weights: [[f64; 4]; 2]) -> Result<Sum, GenError> {
        let size = self.image.grid().size;
        let [across, down] = weights;
        let mut sum = Sum::default();
        for (y, row_weight) in down.into_iter().enumerate() {
            for (x, weight) in across.into_iter().enumerate() {
                let weight = weight * row_weight;
                let place = [first[0] + x as f64 - 1.0, first[1] + y as f64 - 1.0];
                let is_inside = (0..2).all(|axis| (0.0..size[axis] as f64).contains(&place[axis]));
                if weight == 0.0 || !is_inside {
                    continue;
                }
                let pixel = cursor.pixel(place[0] as usize, place[1] as usize)?;
                if P::is_some(pixel) {
                    sum.add(P::values(pixel), weight);
                }
            }
        }
        Ok(sum)
    }
}

impl Sum {
    fn add(&mut self, (values, opacity): ([f64; 3], f64), weight: f64) {
        self.values.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * opacity * value);
        self.opacity += weight * opacity;
        self.weight += weight;
    }

    fn pixel<P: WarpedPixels>(&self) -> u32 {
        if self.weight < MIN_WEIGHT || self.opacity < MIN_WEIGHT {
            return P::NONE;
        }
        P::pixel(self.values.map(|sum| sum / self.opacity), self.opacity / self.weight)
    }
}

impl<P: WarpedPixels> BlockReader for WarpedImage<P> {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let mut cursor = Cursor::new(&self.image);
        let mut pixels = Vec::with_capacity(block.pixels());
        for row in block.row..block.row + block.height {
            for column in block.column..block.column + block.width {
                let [longitude, latitude] = self.to.longitude_latitude(column as f64 + 0.5, row as f64 + 0.5);
                pixels.push(match self.from.pixel(longitude, latitude) {
                    Some(at) => self.pixel(&mut cursor, at)?,
                    None => P::NONE,
                });
            }
        }
        Ok(pixels)
    }
}
