//! One elevation raster in memory: its samples, its position on the earth, and interpolation between samples.

use super::source::ElevationSource;
use crate::georeference::Placement;

/// Heights above this are taken for missing data, such as SRTM's -32768. The earth has no such heights or depths.
const MAX_ABS_HEIGHT_M: f32 = 12_000.0;

/// One elevation file in memory.
pub struct Raster {
    width: usize,
    height: usize,
    /// Metres, north row first; NaN where unknown.
    samples: Vec<f32>,
    placement: Placement,
}

impl Raster {
    /// Creates a raster of heights in metres, NaN where they are unknown. Impossible heights count as unknown. A raster
    /// beyond 180 degrees of longitude is moved by a whole turn onto the earth.
    pub(super) fn new([width, height]: [usize; 2], mut samples: Vec<f32>, placement: Placement) -> Self {
        for h in samples.iter_mut().filter(|h| h.abs() > MAX_ABS_HEIGHT_M) {
            *h = f32::NAN;
        }
        let mut raster = Self { width, height, samples, placement };
        raster.placement = placement.wrapped(raster.bounds());
        raster
    }

    /// Returns true if any sample has a height.
    pub(super) fn has_heights(&self) -> bool {
        self.samples.iter().any(|h| h.is_finite())
    }

    /// Adds a whole turn to the longitudes; the position on the earth stays the same.
    pub(crate) fn turn_east(&mut self) {
        self.placement = self.placement.turned_east();
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

    /// Returns west, south, east and north of the outermost samples in radians.
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
        b
    }

    /// Locates a longitude and latitude in radians relative to the sample centres. `None` if the reference system has
    /// no coordinates there.
    pub(crate) fn locate(&self, longitude: f64, latitude: f64) -> Option<SamplePosition> {
        let [c, r] = self.placement.pixel(longitude, latitude)?;
        let at = [c - 0.5, r - 0.5];
        let last = [self.width as f64 - 1.0, self.height as f64 - 1.0];
        let nearest_px = [0, 1].map(|k| at[k].clamp(0.0, last[k]));
        // Less than a thousandth of a pixel outside is a rounding error.
        let beyond_px = [0, 1].map(|k| at[k] - nearest_px[k]).map(|b: f64| if b.abs() < 1e-3 { 0.0 } else { b });
        Some(SamplePosition { nearest_px, beyond_px })
    }

    /// Interpolates between the four samples around a column and row. Unknown samples are left out and the weights of
    /// the others scaled up; `None` if all four are unknown.
    pub(crate) fn bilinear_m(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (mut sum, mut weights) = (0.0, 0.0);
        for (dx, dy, weight) in
            [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
        {
            let (i, j) = ((x0 as usize + dx).min(self.width - 1), (y0 as usize + dy).min(self.height - 1));
            let sample = f64::from(*self.samples.get(j * self.width + i)?);
            if weight > 0.0 && sample.is_finite() {
                sum += weight * sample;
                weights += weight;
            }
        }
        (weights > 1e-6).then(|| sum / weights)
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
    fn height_m(&self, longitude: f64, latitude: f64) -> Option<f64> {
        let position = self.locate(longitude, latitude).filter(SamplePosition::is_covered)?;
        self.bilinear_m(position.nearest_px)
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
