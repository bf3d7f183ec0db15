//! A raster as a source of elevation.

use super::raster::{Raster, SamplePosition};
use super::source::{ElevationSource, SampleRow, SourceSample};
use super::window::Window;
use crate::{Extent, GenError};

impl ElevationSource for Raster {
    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        match self.locate(longitude, latitude).filter(SamplePosition::is_covered) {
            Some(position) => self.bilinear_m(&mut self.cursor(), position.nearest_px),
            None => Ok(None),
        }
    }

    fn heights_of_row(&self, longitude: f64, step: f64, latitude: f64, out: &mut [f32]) -> Result<(), GenError> {
        out.fill(f32::NAN);
        self.fill_row(&mut self.cursor(), [longitude, step, latitude], out, |_, position| position.is_covered())
    }

    fn heights_of_grid(&self, longitudes: &[f64], latitudes: &[f64], out: &mut [f32]) -> Result<bool, GenError> {
        self.lattice_heights(longitudes, latitudes, out)
    }

    fn sample_rows(
        &self,
        extent: &Extent,
        finds_extrema: bool,
        call: &mut dyn FnMut(SampleRow<'_>),
    ) -> Result<bool, GenError> {
        self.lattice_samples(extent, finds_extrema, call)
    }

    fn samples_in(&self, extent: &Extent, call: &mut dyn FnMut(SourceSample)) -> Result<(), GenError> {
        let Some(window) = Window::of(self, extent) else { return Ok(()) };
        window.samples(
            extent,
            |_, _| Ok(None),
            |sample| {
                call(sample);
                Ok(())
            },
        )
    }

    fn may_have_data_in(&self, extent: &Extent) -> bool {
        Window::of(self, extent).is_some_and(|window| window.may_have_data())
    }
}
