//! The heights of a warped virtual raster: those of its file at the longitude and latitude of each pixel. Threads of the run.

use std::sync::Arc;

use super::super::{Opened, height_bits};
use crate::GenError;
use crate::georeference::Placement;
use crate::store::{BlockCache, BlockGrid, BlockReader, Cursor, PixelImage, Rect};
use crate::virtual_raster::Resampling;

/// The side of a block in pixels.
const BLOCK: usize = 256;
/// The smallest sum of the weights of known heights that make another one.
const MIN_WEIGHT: f64 = 1e-5;

/// A file in another grid.
struct Warped {
    image: PixelImage,
    /// The placements of the file's pixels, and of those of the virtual raster.
    from: Placement,
    to: Placement,
    resampling: Resampling,
}

/// Returns the heights of a file in the grid of a virtual raster of a size. `from` is the placement of the file's pixels,
/// `to` that of the raster's.
pub(super) fn warped(
    file: Opened,
    size: [usize; 2],
    [from, to]: [Placement; 2],
    resampling: Resampling,
    cache: &Arc<BlockCache>,
) -> Opened {
    let image = PixelImage::new(file.grid, file.reader, cache);
    let placement = to.clone();
    let reader = Box::new(Warped { image, from, to, resampling });
    Opened { grid: BlockGrid::new(size, [BLOCK; 2]), reader, placement }
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

impl Warped {
    /// Returns the height at a column and row of the file, whose whole numbers are corners of pixels; NaN outside and where it is
    /// unknown.
    fn height_m(&self, cursor: &mut Cursor<'_>, at: [f64; 2]) -> Result<f32, GenError> {
        let size = self.image.grid().size;
        let is_inside = (0..2).all(|axis| (0.0..size[axis] as f64).contains(&at[axis]));
        if !is_inside {
            return Ok(f32::NAN);
        }
        let own = cursor.pixel(at[0] as usize, at[1] as usize)?;
        if self.resampling == Resampling::Nearest || f32::from_bits(own).is_nan() {
            return Ok(f32::from_bits(own));
        }
        let first = at.map(|at| (at - 0.5).floor());
        let part = [0, 1].map(|axis| at[axis] - 0.5 - first[axis]);
        if self.resampling == Resampling::Cubic {
            let [height, weight] = self.sum(cursor, first, part.map(cubic))?;
            // Beside an edge or a gap GDAL interpolates between four samples.
            if (weight - 1.0).abs() < MIN_WEIGHT {
                return Ok(height as f32);
            }
        }
        let [sum, weight] = self.sum(cursor, first, part.map(|t| [0.0, 1.0 - t, t, 0.0]))?;
        Ok(if weight < MIN_WEIGHT { f32::NAN } else { (sum / weight) as f32 })
    }

    /// Returns the weighted sum of the samples around a position, from one before `first` on, and the sum of the
    /// weights of those that are inside the file and known.
    fn sum(&self, cursor: &mut Cursor<'_>, first: [f64; 2], weights: [[f64; 4]; 2]) -> Result<[f64; 2], GenError> {
        let size = self.image.grid().size;
        let [across, down] = weights;
        let (mut sum, mut known) = (0.0, 0.0);
        for (y, row_weight) in down.into_iter().enumerate() {
            for (x, weight) in across.into_iter().enumerate() {
                let weight = weight * row_weight;
                let place = [first[0] + x as f64 - 1.0, first[1] + y as f64 - 1.0];
                let is_inside = (0..2).all(|axis| (0.0..size[axis] as f64).contains(&place[axis]));
                if weight == 0.0 || !is_inside {
                    continue;
                }
                let height = f64::from(f32::from_bits(cursor.pixel(place[0] as usize, place[1] as usize)?));
                if !height.is_nan() {
                    (sum, known) = (sum + weight * height, known + weight);
                }
            }
        }
        Ok([sum, known])
    }
}

impl BlockReader for Warped {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let mut cursor = Cursor::new(&self.image);
        let mut heights = Vec::with_capacity(block.pixels());
        for row in block.row..block.row + block.height {
            for column in block.column..block.column + block.width {
                let [longitude, latitude] = self.to.longitude_latitude(column as f64 + 0.5, row as f64 + 0.5);
                heights.push(match self.from.pixel(longitude, latitude) {
                    Some(at) => self.height_m(&mut cursor, at)?,
                    None => f32::NAN,
                });
            }
        }
        Ok(height_bits(heights))
    }
}
