//! Reads rasters whose columns are meridians and whose rows are parallels, as most are: positions along both axes are computed once
//! for a whole rectangle, and loops over rows remain. Heights have the bits of [`ElevationSource::height_m`].

use rayon::prelude::*;

use super::raster::{Raster, weighted_m};
use super::source::SampleRow;
use super::window::Window;
use crate::{Extent, GenError};

/// The rows that a thread computes at a time.
const ROWS: usize = 32;

/// A position along an axis, between two samples.
#[derive(Clone, Copy)]
struct Along {
    first: usize,
    second: usize,
    /// The position from the first to the second, 0..1.
    share: f64,
    is_covered: bool,
}

impl Raster {
    /// Returns the positions of columns and rows; `None` if they depend on each other.
    fn along_axes(&self, longitudes: &[f64], latitudes: &[f64]) -> Option<[Vec<Along>; 2]> {
        let (west, south) = (*longitudes.first()?, *latitudes.first()?);
        if !self.has_straight_axes() {
            return None;
        }
        let along = |longitude: f64, latitude: f64, axis: usize| {
            let position = self.locate(longitude, latitude)?;
            let (at, last) = (position.nearest_px[axis], self.size()[axis] - 1);
            let first = at.floor();
            Some(Along {
                first: first as usize,
                second: (first as usize + 1).min(last),
                share: at - first,
                is_covered: position.is_covered_along(axis),
            })
        };
        let columns = longitudes.iter().map(|longitude| along(*longitude, south, 0)).collect::<Option<_>>()?;
        let rows = latitudes.iter().map(|latitude| along(west, *latitude, 1)).collect::<Option<_>>()?;
        Some([columns, rows])
    }

    /// See [`crate::ElevationSource::heights_of_grid`].
    pub(super) fn lattice_heights(
        &self,
        longitudes: &[f64],
        latitudes: &[f64],
        out: &mut [f32],
    ) -> Result<bool, GenError> {
        let Some([columns, rows]) = self.along_axes(longitudes, latitudes) else { return Ok(false) };
        let covered = columns.iter().filter(|column| column.is_covered);
        let range = covered.fold([usize::MAX, 0], |[a, b], column| [a.min(column.first), b.max(column.second)]);
        if range[0] > range[1] {
            out.fill(f32::NAN);
            return Ok(true);
        }
        let width = columns.len();
        out.par_chunks_mut(width * ROWS).zip(rows.par_chunks(ROWS)).try_for_each(|(out, rows)| {
            let mut lines = TwoLines::new(self, range);
            for (out, row) in out.chunks_exact_mut(width).zip(rows) {
                if row.is_covered {
                    let [upper, lower] = lines.at([row.first, row.second])?;
                    pulp::Arch::new().dispatch(
                        #[inline(always)]
                        || interpolate(&columns, range[0], [upper, lower], row.share, out),
                    );
                } else {
                    out.fill(f32::NAN);
                }
            }
            Ok::<_, GenError>(())
        })?;
        Ok(true)
    }

    /// See [`crate::ElevationSource::sample_rows`].
    pub(super) fn lattice_samples(
        &self,
        extent: &Extent,
        finds_extrema: bool,
        call: &mut dyn FnMut(SampleRow<'_>),
    ) -> Result<bool, GenError> {
        if !self.has_straight_axes() {
            return Ok(false);
        }
        let Some(window) = Window::of(self, extent) else { return Ok(true) };
        window.sample_rows(extent, finds_extrema, call)?;
        Ok(true)
    }
}

/// Interpolates along a row between two rows of samples that begin at a column.
#[inline(always)]
fn interpolate(columns: &[Along], first: usize, [upper, lower]: [&[f32]; 2], fy: f64, out: &mut [f32]) {
    for (out, column) in out.iter_mut().zip(columns) {
        let Along { first: i0, second: i1, share: fx, is_covered } = *column;
        if !is_covered {
            *out = f32::NAN;
            continue;
        }
        let samples = [upper[i0 - first], upper[i1 - first], lower[i0 - first], lower[i1 - first]].map(f64::from);
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        let sum = samples[0] * weights[0] + samples[1] * weights[1] + samples[2] * weights[2] + samples[3] * weights[3];
        *out = match sum.is_finite() {
            true => (sum / (weights[0] + weights[1] + weights[2] + weights[3])) as f32,
            false => weighted_m(samples, weights).map_or(f32::NAN, |height_m| height_m as f32),
        };
    }
}

/// Two rows of samples, which are often used again.
struct TwoLines<'a> {
    cursor: crate::store::Cursor<'a>,
    columns: [usize; 2],
    rows: [usize; 2],
    lines: [Vec<f32>; 2],
}

impl<'a> TwoLines<'a> {
    fn new(raster: &'a Raster, columns: [usize; 2]) -> Self {
        Self { cursor: raster.cursor(), columns, rows: [usize::MAX; 2], lines: Default::default() }
    }

    /// Returns the samples of two rows.
    fn at(&mut self, rows: [usize; 2]) -> Result<[&[f32]; 2], GenError> {
        if self.rows[1] == rows[0] || self.rows[0] == rows[1] {
            self.lines.swap(0, 1);
            self.rows.swap(0, 1);
        }
        let [first, last] = self.columns;
        for ((row, line), wanted) in self.rows.iter_mut().zip(&mut self.lines).zip(rows) {
            if *row != wanted {
                line.clear();
                self.cursor.row(first, wanted, last - first + 1, |pixels| {
                    line.extend(pixels.iter().map(|bits| f32::from_bits(*bits)));
                })?;
                *row = wanted;
            }
        }
        let [upper, lower] = &self.lines;
        Ok([upper, lower])
    }
}
