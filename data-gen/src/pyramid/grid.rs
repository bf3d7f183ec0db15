//! The finest level: a square grid of samples over a rectangle of longitude and latitude, rounded to a common quantum.

use rayon::prelude::*;

use crate::{ElevationSource, GenError, Voids};

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
    pub voids: u64,
    /// True for samples without data, in the order of `heights`; empty if there are none, or if they were given heights.
    /// The heights of such samples continue their surroundings.
    is_void: Vec<bool>,
}

/// How a grid is sampled.
pub struct Sampling<'a> {
    /// The treatment of samples without data.
    pub voids: Voids,
    /// Gives the grid's nearest samples the heights of the source's highest and lowest ones. The distance between samples
    /// must be at most the source's.
    pub keep_extrema: bool,
    /// Is called on a worker thread after each of the grid's rows.
    pub row_done: &'a (dyn Fn() + Sync),
}

/// Heights are rounded to 1/128 m, so that a shared sample has the same bits in every tile and level.
pub const QUANTUM_M: f64 = 1.0 / 128.0;

impl Grid {
    /// Samples a source, fills gaps from their surroundings, and rounds to the quantum.
    pub fn sample(source: &dyn ElevationSource, extent: Extent, side: usize) -> Result<Self, GenError> {
        let sampling = Sampling { voids: Voids::Fill, keep_extrema: false, row_done: &|| () };
        Self::sample_rows(source, extent, side, &sampling)
    }

    /// Samples a source and rounds to the quantum.
    pub fn sample_rows(
        source: &dyn ElevationSource,
        extent: Extent,
        side: usize,
        sampling: &Sampling<'_>,
    ) -> Result<Self, GenError> {
        let mut grid = Self { extent, side, heights: vec![0.0f32; side * side], voids: 0, is_void: Vec::new() };
        let cells = (side - 1) as f64;
        let step = (extent.east - extent.west) / cells;
        grid.heights.par_chunks_mut(side).enumerate().try_for_each(|(j, row)| {
            let latitude = extent.south + (extent.north - extent.south) * (j as f64 / cells);
            source.heights_of_row(extent.west, step, latitude, row)?;
            (sampling.row_done)();
            Ok(())
        })?;
        if sampling.keep_extrema {
            grid.keep_extrema(source)?;
        }
        let heights = &mut grid.heights;
        grid.voids = heights.par_iter().filter(|h| !h.is_finite()).count() as u64;
        if grid.voids > 0 {
            match sampling.voids {
                Voids::Cut => grid.is_void = heights.par_iter().map(|h| !h.is_finite()).collect(),
                Voids::Fill => {}
                Voids::Sea => heights.par_iter_mut().filter(|h| !h.is_finite()).for_each(|h| *h = 0.0),
            }
            fill(heights, side, side);
        }
        heights.par_iter_mut().for_each(|h| *h = ((f64::from(*h) / QUANTUM_M).round() * QUANTUM_M) as f32);
        Ok(grid)
    }

    /// Gives the samples nearest to the source's highest and lowest ones their heights, so that peaks between the grid's
    /// samples are not lost.
    fn keep_extrema(&mut self, source: &dyn ElevationSource) -> Result<(), GenError> {
        let found = self.bands().into_par_iter().map(|band| {
            let mut found: Vec<(usize, f32)> = Vec::new();
            source.samples_in(&band, &mut |sample| {
                if sample.is_extremum {
                    let [x, y] = self.position(sample.longitude, sample.latitude).map(|c| c.round() as usize);
                    found.push((y * self.side + x, sample.height_m as f32));
                }
            })?;
            Ok(found)
        });
        let found: Vec<Vec<(usize, f32)>> = found.collect::<Result<_, GenError>>()?;
        for (at, height_m) in found.into_iter().flatten() {
            self.heights[at] = height_m;
        }
        Ok(())
    }

    /// Returns the grid's rectangle in bands from south to north, for the threads. Bands share their edges.
    pub(super) fn bands(&self) -> Vec<Extent> {
        const BANDS: usize = 64;
        let e = self.extent;
        let latitude = |k: usize| e.south + (e.north - e.south) * (k as f64 / BANDS as f64);
        // Samples on the edges of the rectangle may lie outside of it by a rounding error.
        let (south, north) = (e.south - 1e-9, e.north + 1e-9);
        let edge = |k: usize| match k {
            0 => south,
            BANDS => north,
            _ => latitude(k),
        };
        let (west, east) = (e.west - 1e-9, e.east + 1e-9);
        (0..BANDS).map(|k| Extent { west, south: edge(k), east, north: edge(k + 1) }).collect()
    }

    /// Returns the column and row of a longitude and latitude in radians, clamped to the grid.
    pub(super) fn position(&self, longitude: f64, latitude: f64) -> [f64; 2] {
        let (e, cells) = (self.extent, (self.side - 1) as f64);
        let (s, t) = ((longitude - e.west) / (e.east - e.west), (latitude - e.south) / (e.north - e.south));
        // Sample positions that coincide must do so in spite of rounding.
        [s, t].map(|c| (c * cells).clamp(0.0, cells)).map(|c| if (c - c.round()).abs() < 1e-7 { c.round() } else { c })
    }

    /// Returns true if all samples have data, or have been given heights.
    pub(super) fn is_whole(&self) -> bool {
        self.is_void.is_empty()
    }

    /// Returns true for a sample without data.
    pub(super) fn is_void(&self, column: usize, row: usize) -> bool {
        !self.is_void.is_empty() && self.is_void[row * self.side + column]
    }

    /// Returns which triangles of a cell have data at each corner: the south-eastern and the north-western one.
    pub(super) fn triangles(&self, column: usize, row: usize) -> [bool; 2] {
        let known = |i: usize, j: usize| !self.is_void(column + i, row + j);
        let diagonal = known(0, 0) && known(1, 1);
        [diagonal && known(1, 0), diagonal && known(0, 1)]
    }

    /// Returns the lowest and the highest sample with data in metres.
    pub fn range_m(&self) -> [f32; 2] {
        let known = self.heights.iter().enumerate().filter(|(k, _)| self.is_whole() || !self.is_void[*k]);
        known.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], (_, h)| [low.min(*h), high.max(*h)])
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
        fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
            let inside = longitude.hypot(latitude) < 0.3;
            Ok((!inside).then_some(100.0 + longitude))
        }
    }

    #[test]
    fn gaps_are_filled_from_surroundings_and_counted() {
        let extent = Extent { west: -1.0, south: -1.0, east: 1.0, north: 1.0 };
        let g = Grid::sample(&Gap, extent, 65).unwrap();
        assert!(g.voids > 100 && g.is_whole());
        for h in &g.heights {
            assert!((98.5..=101.5).contains(h), "{h}");
            assert_eq!(f64::from(*h) / QUANTUM_M, (f64::from(*h) / QUANTUM_M).round());
        }
    }

    #[test]
    fn voids_are_cut_or_become_sea() {
        let extent = Extent { west: -1.0, south: -1.0, east: 1.0, north: 1.0 };
        let of = |voids| {
            let sampling = Sampling { voids, keep_extrema: false, row_done: &|| () };
            Grid::sample_rows(&Gap, extent, 65, &sampling).unwrap()
        };
        let (filled, cut, sea) = (of(Voids::Fill), of(Voids::Cut), of(Voids::Sea));
        assert_eq!([cut.voids, sea.voids], [filled.voids; 2]);
        // The middle of the grid lies in the gap, and its corner does not.
        assert!(cut.is_void(32, 32) && !cut.is_void(0, 0) && sea.is_whole());
        assert_eq!((cut.triangles(32, 32), cut.triangles(0, 0)), ([false; 2], [true; 2]));
        assert_eq!((&cut.heights, sea.heights[32 * 65 + 32]), (&filled.heights, 0.0));
        assert_eq!([cut.range_m()[0], sea.range_m()[0]], [99.0, 0.0]);
    }
}
