//! The finest level: a square grid of samples over a rectangle of longitude and latitude, rounded to a common quantum.

use rayon::prelude::*;

use crate::ElevationSource;

/// A rectangle of longitude and latitude in radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Western edge.
    pub west: f64,
    /// Southern edge.
    pub south: f64,
    /// Eastern edge.
    pub east: f64,
    /// Northern edge.
    pub north: f64,
}

/// A square grid of heights. Each height is a multiple of 1/128 m.
#[derive(Clone, Debug)]
pub struct Grid {
    /// The rectangle of the outermost samples.
    pub extent: Extent,
    /// The number of samples along a side, `64 * 2^n + 1`.
    pub side: usize,
    /// `side * side` heights in metres, rows from south to north, each from west to east.
    pub heights: Vec<f32>,
    /// The number of samples for which the source had no data.
    pub filled: u64,
}

/// Heights are rounded to 1/128 m, so that a shared sample has the same bits in every tile and level.
pub const QUANTUM_M: f64 = 1.0 / 128.0;

impl Grid {
    /// Samples a source, fills gaps from their surroundings, and rounds to the quantum.
    pub fn sample(source: &dyn ElevationSource, extent: Extent, side: usize) -> Self {
        Self::sample_rows(source, extent, side, &|| ())
    }

    /// Like [`Self::sample`]; calls `row_done` on a worker thread after each of the `side` rows.
    pub fn sample_rows(
        source: &dyn ElevationSource,
        extent: Extent,
        side: usize,
        row_done: &(dyn Fn() + Sync),
    ) -> Self {
        let mut heights = vec![0.0f32; side * side];
        let cells = (side - 1) as f64;
        heights.par_chunks_mut(side).enumerate().for_each(|(j, row)| {
            let latitude = extent.south + (extent.north - extent.south) * (j as f64 / cells);
            for (i, h) in row.iter_mut().enumerate() {
                let longitude = extent.west + (extent.east - extent.west) * (i as f64 / cells);
                *h = source.height_m(longitude, latitude).map_or(f32::NAN, |h| h as f32);
            }
            row_done();
        });
        let filled = heights.par_iter().filter(|h| !h.is_finite()).count() as u64;
        if filled > 0 {
            fill(&mut heights, side, side);
        }
        heights.par_iter_mut().for_each(|h| *h = ((f64::from(*h) / QUANTUM_M).round() * QUANTUM_M) as f32);
        Self { extent, side, heights, filled }
    }
}

/// Replaces NaN by the push-pull method: known samples are averaged on coarser and coarser grids, then interpolated
/// bilinearly back, so that gaps continue their surroundings smoothly. If all samples are unknown, they become 0.
fn fill(heights: &mut [f32], width: usize, height: usize) {
    if !heights.iter().any(|h| !h.is_finite()) {
        return;
    }
    if width <= 1 && height <= 1 {
        heights.fill(0.0);
        return;
    }
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let mut coarse = vec![f32::NAN; w * h];
    for (j, row) in coarse.chunks_mut(w).enumerate() {
        for (i, out) in row.iter_mut().enumerate() {
            let (mut sum, mut count) = (0.0f64, 0);
            for y in 2 * j..(2 * j + 2).min(height) {
                for x in 2 * i..(2 * i + 2).min(width) {
                    let v = heights[y * width + x];
                    if v.is_finite() {
                        sum += f64::from(v);
                        count += 1;
                    }
                }
            }
            if count > 0 {
                *out = (sum / f64::from(count)) as f32;
            }
        }
    }
    fill(&mut coarse, w, h);
    for j in 0..height {
        for i in 0..width {
            if heights[j * width + i].is_finite() {
                continue;
            }
            let (x, y) = ((i as f64 - 0.5) / 2.0, (j as f64 - 0.5) / 2.0);
            let (x, y) = (x.clamp(0.0, (w - 1) as f64), y.clamp(0.0, (h - 1) as f64));
            let (x0, y0) = (x as usize, y as usize);
            let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
            let (fx, fy) = (x - x0 as f64, y - y0 as f64);
            let at = |x: usize, y: usize| f64::from(coarse[y * w + x]);
            let low = at(x0, y0) * (1.0 - fx) + at(x1, y0) * fx;
            let high = at(x0, y1) * (1.0 - fx) + at(x1, y1) * fx;
            heights[j * width + i] = (low * (1.0 - fy) + high * fy) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Gap;

    impl ElevationSource for Gap {
        fn height_m(&self, longitude: f64, latitude: f64) -> Option<f64> {
            let inside = longitude.hypot(latitude) < 0.3;
            (!inside).then_some(100.0 + longitude)
        }
    }

    #[test]
    fn gaps_are_filled_from_surroundings_and_counted() {
        let extent = Extent { west: -1.0, south: -1.0, east: 1.0, north: 1.0 };
        let g = Grid::sample(&Gap, extent, 65);
        assert!(g.filled > 100);
        for h in &g.heights {
            assert!((98.5..=101.5).contains(h), "{h}");
            assert_eq!(f64::from(*h) / QUANTUM_M, (f64::from(*h) / QUANTUM_M).round());
        }
    }
}
