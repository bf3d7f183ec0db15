//! A source whose longitudes go on beyond 180 degrees, on the longitudes of the tiling, which end there.

use std::f64::consts::{PI, TAU};

use crate::georeference::ROUNDING;
use crate::{ElevationSource, Extent, GenError, SourceSample};

/// The source at longitudes of -180 to 180 degrees.
pub(super) struct Turned<'a> {
    source: &'a dyn ElevationSource,
    /// The western edge of a source across the date line; `None` for others.
    west: Option<f64>,
}

impl<'a> Turned<'a> {
    pub fn new(source: &'a dyn ElevationSource, extent: Extent) -> Self {
        Self { source, west: (extent.east > PI + ROUNDING).then_some(extent.west) }
    }

    /// Returns the longitude on the source's side of the date line.
    fn longitude(&self, longitude: f64) -> f64 {
        match self.west {
            Some(west) if longitude < west - ROUNDING => longitude + TAU,
            _ => longitude,
        }
    }
}

impl ElevationSource for Turned<'_> {
    fn is_formula(&self) -> bool {
        self.source.is_formula()
    }

    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        self.source.height_m(self.longitude(longitude), latitude)
    }

    fn heights_of_row(&self, longitude: f64, step: f64, latitude: f64, out: &mut [f32]) -> Result<(), GenError> {
        let last = longitude + step * out.len() as f64;
        match self.west {
            Some(west) if longitude < west && last >= west => {
                for (k, height_m) in out.iter_mut().enumerate() {
                    *height_m = self.height_m(longitude + step * k as f64, latitude)?.map_or(f32::NAN, |h| h as f32);
                }
                Ok(())
            }
            _ => self.source.heights_of_row(self.longitude(longitude), step, latitude, out),
        }
    }

    fn heights_of_grid(&self, longitudes: &[f64], latitudes: &[f64], out: &mut [f32]) -> Result<bool, GenError> {
        let turned: Vec<f64> = longitudes.iter().map(|longitude| self.longitude(*longitude)).collect();
        // Columns on both sides of the source's western edge are no grid. Files are read by rows: a coarse tile may contain a
        // large part.
        if !self.source.is_formula() || !turned.is_sorted() {
            return Ok(false);
        }
        self.source.heights_of_grid(&turned, latitudes, out)
    }

    fn water_depths_m(&self, longitudes: &[f64], latitudes: &[f64], out: &mut [f32]) -> Result<bool, GenError> {
        let turned: Vec<f64> = longitudes.iter().map(|longitude| self.longitude(*longitude)).collect();
        self.source.water_depths_m(&turned, latitudes, out)
    }

    fn samples_in(&self, extent: &Extent, call: &mut dyn FnMut(SourceSample)) -> Result<(), GenError> {
        self.source.samples_in(extent, call)?;
        let Some(west) = self.west.filter(|west| extent.west < *west) else { return Ok(()) };
        let east = extent.east.min(west) + TAU;
        self.source.samples_in(&Extent { west: extent.west + TAU, east, ..*extent }, &mut |sample| {
            call(SourceSample { longitude: sample.longitude - TAU, ..sample });
        })
    }

    fn prepare(&self, extent: &Extent) {
        self.source.prepare(extent);
        if self.west.is_some() {
            self.source.prepare(&Extent { west: extent.west + TAU, east: extent.east + TAU, ..*extent });
        }
    }

    fn may_have_data_in(&self, extent: &Extent) -> bool {
        let turned = Extent { west: extent.west + TAU, east: extent.east + TAU, ..*extent };
        self.source.may_have_data_in(extent) || self.west.is_some() && self.source.may_have_data_in(&turned)
    }
}
