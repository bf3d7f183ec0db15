//! The samples of a raster inside a rectangle of longitude and latitude.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use super::raster::Raster;
use super::source::{SampleRow, SourceSample};
use crate::store::Cursor;
use crate::{Extent, GenError};

/// The number of parts of a rectangle's sides whose ends are located in the raster.
const PARTS: usize = 32;
/// Samples that are added on each side, because the sides of a rectangle are curves in the raster.
const MARGIN: f64 = 3.0;
/// Samples along the edge of a raster may lie beyond its measured bounds by this share of a side, for the same reason.
const BOUNDS_MARGIN: f64 = 0.01;
/// The largest number of blocks that are asked whether they are empty.
const MAX_BLOCKS: usize = 4096;

/// The columns and rows of a raster that may lie inside a rectangle.
pub(super) struct Window<'a> {
    raster: &'a Raster,
    /// Columns from the first one on. Those of a raster around the earth may be negative, or larger than its width.
    columns: RangeInclusive<i64>,
    rows: RangeInclusive<i64>,
}

impl<'a> Window<'a> {
    /// Finds the columns and rows; `None` if there are none.
    pub fn of(raster: &'a Raster, extent: &Extent) -> Option<Self> {
        let [width, height] = raster.size();
        // The first column may be stored a second time, as the last one.
        let width = raster.around().unwrap_or(width);
        let whole = Self { raster, columns: 0..=width as i64 - 1, rows: 0..=height as i64 - 1 };
        let [west, south, east, north] = raster.bounds();
        let (dx, dy) = (BOUNDS_MARGIN * (east - west) + 1e-9, BOUNDS_MARGIN * (north - south) + 1e-9);
        let mut e = Extent {
            west: extent.west.max(west - dx),
            south: extent.south.max(south - dy),
            east: extent.east.min(east + dx),
            north: extent.north.min(north + dy),
        };
        if raster.around().is_some() {
            (e.west, e.east) = (extent.west, extent.east);
        }
        if e.west > e.east || e.south > e.north {
            return None;
        }
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for k in 0..=PARTS {
            let t = k as f64 / PARTS as f64;
            let (x, y) = (e.west + t * (e.east - e.west), e.south + t * (e.north - e.south));
            for (longitude, latitude) in [(x, e.south), (x, e.north), (e.west, y), (e.east, y)] {
                // Reference systems may have no coordinates at the poles, for example.
                let Some(at) = raster.pixel(longitude, latitude) else { return Some(whole) };
                for axis in 0..2 {
                    low[axis] = low[axis].min(at[axis]);
                    high[axis] = high[axis].max(at[axis]);
                }
            }
        }
        // A sample's column is half a pixel less than the coordinate of its centre.
        let range = |axis: usize| (low[axis] - 0.5 - MARGIN).floor() as i64..=(high[axis] - 0.5 + MARGIN).ceil() as i64;
        let within =
            |range: RangeInclusive<i64>, count: usize| *range.start().max(&0)..=*range.end().min(&(count as i64 - 1));
        let (columns, rows) = (range(0), within(range(1), height));
        let columns = match raster.around() {
            Some(around) if columns.end() - columns.start() + 1 < around as i64 => columns,
            Some(_) => whole.columns,
            None => within(columns, width),
        };
        (columns.start() <= columns.end() && rows.start() <= rows.end()).then_some(Self { raster, columns, rows })
    }

    /// Returns false if it is known that no sample has data.
    pub fn may_have_data(&self) -> bool {
        let grid = self.raster.image().grid();
        let [first_row, last_row] = [self.rows.start(), self.rows.end()].map(|row| *row as usize / grid.block[1]);
        let runs = self.runs();
        let blocks =
            |run: &RangeInclusive<i64>| *run.start() as usize / grid.block[0]..=*run.end() as usize / grid.block[0];
        let count: usize = runs.iter().map(|run| blocks(run).count() * (last_row - first_row + 1)).sum();
        count > MAX_BLOCKS
            || runs.iter().flat_map(blocks).any(|x| {
                (first_row..=last_row).any(|y| {
                    let (rect, _) = grid.block_of(x * grid.block[0], y * grid.block[1]);
                    !self.raster.image().reader().is_known_empty(rect)
                })
            })
    }

    /// Reads the blocks with the samples, several at the same time.
    pub fn read_ahead(&self) {
        let rows = *self.rows.start() as usize..=*self.rows.end() as usize;
        for run in self.runs() {
            self.raster.image().read_ahead(*run.start() as usize..=*run.end() as usize, rows.clone());
        }
    }

    /// Returns the columns as ranges inside the raster.
    fn runs(&self) -> Vec<RangeInclusive<i64>> {
        let Some(around) = self.raster.around().map(|around| around as i64) else { return vec![self.columns.clone()] };
        let (start, end) = (*self.columns.start(), *self.columns.end());
        let first = start.rem_euclid(around);
        let last = first + end - start;
        let mut runs = vec![first..=last.min(around - 1)];
        if last >= around {
            runs.push(0..=last - around);
        }
        runs
    }

    /// Calls with each sample inside a rectangle, row by row. `outside` gives the heights in metres beyond the edges of the
    /// raster, at a longitude and latitude in radians.
    pub fn samples(
        &self,
        extent: &Extent,
        outside: impl Fn(f64, f64) -> Result<Option<f64>, GenError>,
        mut call: impl FnMut(SourceSample) -> Result<(), GenError>,
    ) -> Result<(), GenError> {
        let turns: &[f64] = if self.raster.around().is_some() { &[0.0, TAU, -TAU] } else { &[0.0] };
        for run in self.runs() {
            let mut lines = Lines::new(self.raster, run.clone());
            for row in self.rows.clone() {
                lines.move_to(row)?;
                for column in run.clone() {
                    let height_m = lines.at(column, row);
                    if !height_m.is_finite() {
                        continue;
                    }
                    let [longitude, latitude] = self.raster.position(column, row);
                    let longitude = match turns.len() {
                        1 => longitude,
                        _ => longitude - (longitude / TAU).round() * TAU,
                    };
                    if !(extent.south..=extent.north).contains(&latitude) {
                        continue;
                    }
                    // A meridian at 180 degrees may be both edges of the rectangle.
                    for turn in turns.iter().filter(|turn| (extent.west..=extent.east).contains(&(longitude + **turn)))
                    {
                        let is_extremum = lines.is_extremum(column, row, &outside)?;
                        let height_m = f64::from(height_m);
                        call(SourceSample { longitude: longitude + turn, latitude, height_m, is_extremum })?;
                    }
                }
            }
        }
        Ok(())
    }
}

impl Window<'_> {
    /// Calls with each row of the samples inside a rectangle. The raster has straight axes, and no other raster beside it.
    pub fn sample_rows(
        &self,
        extent: &Extent,
        finds_extrema: bool,
        call: &mut dyn FnMut(SampleRow<'_>),
    ) -> Result<(), GenError> {
        let longitude = |column: i64| self.raster.position(column, *self.rows.start())[0];
        let is_inside = |column: &i64| (extent.west..=extent.east).contains(&longitude(*column));
        let (Some(first), Some(last)) =
            (self.columns.clone().find(is_inside), self.columns.clone().rev().find(is_inside))
        else {
            return Ok(());
        };
        let longitudes: Vec<f64> = (first..=last).map(longitude).collect();
        let mut lines = Lines::new(self.raster, first..=last);
        let mut is_extremum = vec![false; if finds_extrema { longitudes.len() } else { 0 }];
        for row in self.rows.clone() {
            let latitude = self.raster.position(first, row)[1];
            if !(extent.south..=extent.north).contains(&latitude) {
                continue;
            }
            lines.move_to(row)?;
            if finds_extrema {
                // Without the attribute the loop would be compiled for any processor.
                pulp::Arch::new().dispatch(
                    #[inline(always)]
                    || find_extrema(&lines.lines, &mut is_extremum),
                );
            }
            let heights_m = &lines.lines[1][1..=longitudes.len()];
            call(SampleRow { latitude, longitudes: &longitudes, heights_m, is_extremum: &is_extremum });
        }
        Ok(())
    }
}

/// Finds the samples of the second of three lines that are higher, or lower, than each of their neighbours with data. Lines have one
/// more sample at both ends.
#[inline(always)]
fn find_extrema(lines: &[Vec<f32>; 3], out: &mut [bool]) {
    let count = out.len();
    let [above, own, below] = lines.each_ref().map(|line| &line[..count + 2]);
    for (k, out) in out.iter_mut().enumerate() {
        // Comparisons with NaN are false.
        let larger = |most: f32, h: f32| if h > most { h } else { most };
        let smaller = |least: f32, h: f32| if h < least { h } else { least };
        let around = [above[k], above[k + 1], above[k + 2], own[k], own[k + 2], below[k], below[k + 1], below[k + 2]];
        let (most, least) =
            (around.into_iter().fold(f32::NEG_INFINITY, larger), around.into_iter().fold(f32::INFINITY, smaller));
        let own = f64::from(own[k + 1]);
        *out = (f64::from(most) < own - 1e-6) | (f64::from(least) > own + 1e-6);
    }
}

/// Three rows of samples: the current one, and those before and after it.
struct Lines<'a> {
    raster: &'a Raster,
    cursor: Cursor<'a>,
    /// The first column of the lines.
    first: i64,
    count: usize,
    /// The lines of the rows `row - 1`, `row` and `row + 1`, NaN outside of the raster; none at first.
    lines: [Vec<f32>; 3],
    row: i64,
}

impl<'a> Lines<'a> {
    /// Creates lines for columns inside the raster, with one more column on both sides.
    fn new(raster: &'a Raster, columns: RangeInclusive<i64>) -> Self {
        let count = (columns.end() - columns.start() + 3) as usize;
        let lines = Default::default();
        Self { raster, cursor: raster.cursor(), first: columns.start() - 1, count, lines, row: i64::MIN }
    }

    /// Moves to a row, usually the next one.
    fn move_to(&mut self, row: i64) -> Result<(), GenError> {
        if row == self.row.saturating_add(1) {
            self.lines.rotate_left(1);
            self.lines[2] = self.read(row + 1)?;
        } else {
            for (k, line) in [row - 1, row, row + 1].into_iter().enumerate() {
                self.lines[k] = self.read(line)?;
            }
        }
        self.row = row;
        Ok(())
    }

    fn read(&mut self, row: i64) -> Result<Vec<f32>, GenError> {
        let [width, height] = self.raster.size().map(|side| side as i64);
        let mut line = Vec::with_capacity(self.count);
        if !(0..height).contains(&row) {
            line.resize(self.count, f32::NAN);
            return Ok(line);
        }
        let (mut column, end) = (self.first, self.first + self.count as i64);
        while column < end {
            let inside = self.raster.around().map_or(column, |around| column.rem_euclid(around as i64));
            if !(0..width).contains(&inside) {
                line.push(f32::NAN);
                column += 1;
                continue;
            }
            let next = self.raster.around().map_or(width, |around| around as i64);
            let run = (end - column).min(next - inside);
            self.cursor.row(inside as usize, row as usize, run as usize, |pixels| {
                line.extend(pixels.iter().map(|bits| f32::from_bits(*bits)));
            })?;
            column += run;
        }
        Ok(line)
    }

    /// Returns the height of a sample in the three rows.
    fn at(&self, column: i64, row: i64) -> f32 {
        self.lines[(row - self.row + 1) as usize][(column - self.first) as usize]
    }

    /// Returns true if a sample of the current row is higher, or lower, than each of its neighbours with data.
    fn is_extremum(
        &self,
        column: i64,
        row: i64,
        outside: impl Fn(f64, f64) -> Result<Option<f64>, GenError>,
    ) -> Result<bool, GenError> {
        let own = f64::from(self.at(column, row));
        let [width, height] = self.raster.size().map(|side| side as i64);
        let (mut is_highest, mut is_lowest) = (true, true);
        for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
            let (x, y) = (column + dx, row + dy);
            let is_stored = (0..height).contains(&y) && (self.raster.around().is_some() || (0..width).contains(&x));
            let other = if is_stored {
                f64::from(self.at(x, y))
            } else {
                let [longitude, latitude] = self.raster.position(x, y);
                outside(longitude, latitude)?.unwrap_or(f64::NAN)
            };
            // Heights beyond the edges are interpolated, with rounding errors.
            is_highest &= other.is_nan() || other < own - 1e-6;
            is_lowest &= other.is_nan() || other > own + 1e-6;
            if !is_highest && !is_lowest {
                return Ok(false);
            }
        }
        Ok(true)
    }
}
