//! One elevation raster in memory: its samples, its position on the earth, and interpolation between samples.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

use rayon::prelude::*;

use super::source::ElevationSource;
use crate::georeference::{Geoid, Placement, ROUNDING};
use crate::{Extent, GenError};

/// Heights above this are taken for missing data, such as the lowest number of a format. Heights in decimetres are below
/// it.
const MAX_ABS_HEIGHT_M: f32 = 100_000.0;

/// One elevation file in memory.
pub struct Raster {
    width: usize,
    height: usize,
    /// The number of columns once around the earth; `None` if the raster does not reach around it.
    around: Option<usize>,
    /// Metres, north row first; NaN where unknown.
    samples: Vec<f32>,
    placement: Placement,
}

impl Raster {
    /// Creates a raster of heights in metres, NaN where they are unknown. Impossible heights count as unknown. A raster
    /// beyond 180 degrees of longitude is moved by a whole turn onto the earth; one around the earth has no ends.
    pub(super) fn new([width, height]: [usize; 2], mut samples: Vec<f32>, placement: Placement) -> Self {
        for h in samples.iter_mut().filter(|h| h.abs() > MAX_ABS_HEIGHT_M) {
            *h = f32::NAN;
        }
        let mut raster = Self { width, height, around: None, samples, placement };
        raster.around = raster.columns_around();
        if raster.around.is_none() {
            raster.placement = raster.placement.clone().wrapped(raster.bounds());
        }
        raster
    }

    /// Returns the number of columns once around the earth if the raster reaches around it. Its last column may be the
    /// first one again.
    fn columns_around(&self) -> Option<usize> {
        let (middle, columns) = (0.5 * self.height as f64, self.width as f64);
        let longitude = |column: f64| self.placement.longitude_latitude(column, middle)[0];
        let wide = longitude(columns - 0.5) - longitude(0.5);
        let step = wide / (columns - 1.0);
        let is_north_up = self.placement.longitude_latitude(0.5, 0.5)[0] == longitude(0.5);
        let found = [self.width, self.width - 1].into_iter().find(|n| (step * *n as f64 - TAU).abs() < 0.01 * step);
        found.filter(|columns| is_north_up && *columns >= 4)
    }

    /// Returns true if any sample has a height.
    pub(super) fn has_heights(&self) -> bool {
        self.samples.iter().any(|h| h.is_finite())
    }

    /// Adds a whole turn to the longitudes; the position on the earth stays the same.
    pub(crate) fn turn_east(&mut self) {
        if self.around.is_none() {
            self.placement = self.placement.clone().turned_east();
        }
    }

    /// Adds the height of a geoid to each sample. Returns false if the geoid has no height at one of them.
    pub(crate) fn raise(&mut self, geoid: &Geoid) -> bool {
        let (placement, width) = (&self.placement, self.width);
        self.samples.par_chunks_mut(width).enumerate().all(|(row, samples)| {
            samples.iter_mut().enumerate().filter(|(_, h)| h.is_finite()).all(|(column, h)| {
                let [longitude, latitude] = placement.longitude_latitude(column as f64 + 0.5, row as f64 + 0.5);
                let Some(undulation_m) = geoid.height_m(longitude, latitude) else { return false };
                *h = (f64::from(*h) + undulation_m) as f32;
                true
            })
        })
    }

    /// Returns the width and height in samples.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Returns the lowest and the highest sample in metres.
    pub fn range_m(&self) -> [f32; 2] {
        let finite = self.samples.iter().filter(|h| h.is_finite());
        finite.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], h| [a.min(*h), b.max(*h)])
    }

    /// Returns west, south, east and north of the outermost samples in radians. A raster around the earth reaches from
    /// -180 to 180 degrees, and to the poles if its pixels do.
    pub fn bounds(&self) -> [f64; 4] {
        let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        let (w, h) = (self.width as f64, self.height as f64);
        for i in 0..=16 {
            let t = f64::from(i) / 16.0;
            let (c, r) = (0.5 + t * (w - 1.0), 0.5 + t * (h - 1.0));
            for (column, row) in [(c, 0.5), (c, h - 0.5), (0.5, r), (w - 0.5, r)] {
                let [lon, lat] = self.placement.longitude_latitude(column, row);
                b = [b[0].min(lon), b[1].min(lat), b[2].max(lon), b[3].max(lat)];
            }
        }
        if self.around.is_some() {
            let edges = [0.0, h].map(|row| self.placement.longitude_latitude(0.5, row)[1]);
            let [south, north] = [edges[0].min(edges[1]), edges[0].max(edges[1])];
            let is_pole = |edge: f64| (edge.abs() - FRAC_PI_2).abs() < ROUNDING;
            b = [
                -PI,
                if is_pole(south) { -FRAC_PI_2 } else { b[1] },
                PI,
                if is_pole(north) { FRAC_PI_2 } else { b[3] },
            ];
        }
        b
    }

    /// Returns the distance between samples along the longer sides of the bounds, east and north, in radians.
    pub(crate) fn sample_distance(&self) -> [f64; 2] {
        let [west, south, east, north] = self.bounds();
        let columns = self.around.unwrap_or(self.width.max(2) - 1);
        // Samples around the earth lie half a pixel from the poles.
        let rows =
            if self.around.is_some() && north - south > PI - ROUNDING { self.height } else { self.height.max(2) - 1 };
        [(east - west) / columns as f64, (north - south) / rows as f64]
    }

    /// Returns a sample, and its longitude and latitude in radians; `None` without data.
    pub(crate) fn sample(&self, column: usize, row: usize) -> Option<([f64; 2], f64)> {
        let height_m = *self.samples.get(row * self.width + column).filter(|h| h.is_finite())?;
        let [longitude, latitude] = self.placement.longitude_latitude(column as f64 + 0.5, row as f64 + 0.5);
        let turns = if self.around.is_some() { (longitude / TAU).round() * TAU } else { 0.0 };
        Some(([longitude - turns, latitude], height_m.into()))
    }

    /// Returns true if a sample is higher, or lower, than each of its neighbours with data. `outside` gives the heights in
    /// metres of those beyond the edges, at a longitude and latitude in radians.
    pub(crate) fn is_extremum(&self, column: usize, row: usize, outside: impl Fn(f64, f64) -> Option<f64>) -> bool {
        let at = |dx: i64, dy: i64| {
            let (x, y) = (column as i64 + dx, row as i64 + dy);
            let x = self.around.map_or(x, |columns| x.rem_euclid(columns as i64));
            if (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y) {
                return self.samples.get(y as usize * self.width + x as usize).map_or(f64::NAN, |h| f64::from(*h));
            }
            let [longitude, latitude] = self.placement.longitude_latitude(x as f64 + 0.5, y as f64 + 0.5);
            outside(longitude, latitude).unwrap_or(f64::NAN)
        };
        let own = at(0, 0);
        let around = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)].map(|(dx, dy)| at(dx, dy));
        let is_none = |test: fn(f64, f64) -> bool| !around.iter().any(|other| test(*other, own));
        // Heights beyond the edges are interpolated, with rounding errors.
        own.is_finite() && (is_none(|other, own| other >= own - 1e-6) || is_none(|other, own| other <= own + 1e-6))
    }

    /// Returns the height in metres at a longitude and latitude in radians, `None` without data.
    pub(crate) fn at(&self, longitude: f64, latitude: f64) -> Option<f64> {
        let position = self.locate(longitude, latitude).filter(SamplePosition::is_covered)?;
        self.bilinear_m(position.nearest_px)
    }

    /// Returns the columns and rows around the samples in a rectangle.
    pub(crate) fn samples_within(&self, e: &Extent) -> [Range<usize>; 2] {
        let sides = [self.width, self.height];
        if self.around.is_some() {
            return sides.map(|side| 0..side);
        }
        let range_of = |steps: i32| {
            let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
            for (i, j) in (0..=steps).flat_map(|j| (0..=steps).map(move |i| (i, j))) {
                let [s, t] = [i, j].map(|c| f64::from(c) / f64::from(steps));
                let at = self.placement.pixel(e.west + s * (e.east - e.west), e.south + t * (e.north - e.south))?;
                range = [0, 1].map(|k| [range[k][0].min(at[k]), range[k][1].max(at[k])]);
            }
            Some(range)
        };
        // Rows of the reference system are straight over a few pixels.
        let is_small = |range: &[[f64; 2]; 2]| range.iter().all(|[first, last]| last - first < 8.0);
        let Some(range) = range_of(1).filter(is_small).or_else(|| range_of(16)) else {
            return sides.map(|side| 0..side);
        };
        [0, 1].map(|k| {
            let [first, last] = [range[k][0] - 2.0, range[k][1] + 2.0].map(|c| c.clamp(0.0, sides[k] as f64) as usize);
            first..last
        })
    }

    /// Locates a longitude and latitude in radians relative to the sample centres. `None` if the reference system has
    /// no coordinates there.
    pub(crate) fn locate(&self, longitude: f64, latitude: f64) -> Option<SamplePosition> {
        let [c, r] = self.placement.pixel(longitude, latitude)?;
        let mut at = [c - 0.5, r - 0.5];
        let mut last = [self.width as f64 - 1.0, self.height as f64 - 1.0];
        if let Some(columns) = self.around {
            // Rounding may give the number of columns itself.
            at[0] = at[0].rem_euclid(columns as f64);
            last[0] = columns as f64;
        }
        let nearest_px = [0, 1].map(|k| at[k].clamp(0.0, last[k]));
        // Less than a thousandth of a pixel outside is a rounding error.
        let beyond_px = [0, 1].map(|k| at[k] - nearest_px[k]).map(|b: f64| if b.abs() < 1e-3 { 0.0 } else { b });
        Some(SamplePosition { nearest_px, beyond_px })
    }

    /// Interpolates between the four samples around a column and row. Samples without data are left out and the weights of
    /// the others scaled up; `None` if the nearest sample has no data.
    pub(crate) fn bilinear_m(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (mut sum, mut weights, mut nearest) = (0.0, 0.0, (0.0, f64::NAN));
        for (dx, dy, weight) in
            [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
        {
            let (i, j) = (self.column(x0 as usize + dx), (y0 as usize + dy).min(self.height - 1));
            let sample = f64::from(*self.samples.get(j * self.width + i)?);
            if weight > nearest.0 {
                nearest = (weight, sample);
            }
            if weight > 0.0 && sample.is_finite() {
                sum += weight * sample;
                weights += weight;
            }
        }
        nearest.1.is_finite().then(|| sum / weights)
    }

    /// Returns the column of a sample: the last one, or the first again, if `column` is beyond the last.
    fn column(&self, column: usize) -> usize {
        self.around.map_or(column.min(self.width - 1), |columns| column % columns)
    }

    /// Returns a column's step east and a row's step north at the centre, in radians. `None` if the raster is rotated
    /// so far that its columns run north rather than east.
    pub(crate) fn steps(&self) -> Option<[f64; 2]> {
        let (c, r) = (0.5 * self.width as f64, 0.5 * self.height as f64);
        let step = |[dc, dr]: [f64; 2]| {
            let [a, b] = self.placement.longitude_latitude(c - dc, r - dr);
            let [x, y] = self.placement.longitude_latitude(c + dc, r + dr);
            [x - a, y - b]
        };
        let (column, row) = (step([0.5, 0.0]), step([0.0, 0.5]));
        (column[0].abs() > column[1].abs() && row[1].abs() > row[0].abs()).then_some([column[0], row[1]])
    }
}

impl ElevationSource for Raster {
    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        Ok(self.at(longitude, latitude))
    }
}

/// A position relative to the sample centres of a raster.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SamplePosition {
    /// The nearest column and row inside the rectangle of the sample centres; whole numbers are centres.
    pub nearest_px: [f64; 2],
    /// Columns and rows from there to the position; 0 along an axis on which it lies inside the rectangle.
    pub beyond_px: [f64; 2],
}

impl SamplePosition {
    /// Returns true if the position lies inside the raster. The area of the outermost samples ends half a pixel beyond
    /// their centres; the excess over 0.5 allows for rounding.
    pub fn is_covered(&self) -> bool {
        self.beyond_px.iter().all(|b| b.abs() <= 0.501)
    }
}
