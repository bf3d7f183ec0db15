//! The interface between elevation data and the sampling of the grid.

use crate::{Extent, GenError};

/// Heights as a function of position. Called from several threads at the same time; a source may read files in a call.
pub trait ElevationSource: Sync {
    /// Returns the height in metres above the ellipsoid at a longitude and latitude in radians, `None` where the
    /// source has no data. The result depends on the position alone.
    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError>;

    /// Computes the heights along a row of positions at one latitude, `longitude + k * step`, in radians: NaN where the
    /// source has no data. The results are those of [`Self::height_m`], rounded to `f32`.
    fn heights_of_row(&self, longitude: f64, step: f64, latitude: f64, out: &mut [f32]) -> Result<(), GenError> {
        for (k, height_m) in out.iter_mut().enumerate() {
            *height_m = self.height_m(longitude + step * k as f64, latitude)?.map_or(f32::NAN, |h| h as f32);
        }
        Ok(())
    }

    /// Computes the heights at all pairs of longitudes and latitudes in radians, row by row in the order of the latitudes, with the
    /// bits of [`Self::heights_of_row`]. Returns false if the source has no quicker way than rows; `out` is then unchanged.
    fn heights_of_grid(&self, _longitudes: &[f64], _latitudes: &[f64], _out: &mut [f32]) -> Result<bool, GenError> {
        Ok(false)
    }

    /// Computes the depth of open water in metres, below 0 on land, at all pairs of longitudes and latitudes in radians, row by row in
    /// the order of the latitudes. Returns false if the source does not know where water is; `out` is then unchanged.
    fn water_depths_m(&self, _longitudes: &[f64], _latitudes: &[f64], _out: &mut [f32]) -> Result<bool, GenError> {
        Ok(false)
    }

    /// Calls with the samples of [`Self::samples_in`] in rows, if all rows have the same longitudes. Returns false, without a
    /// call, if they have not. [`SampleRow::is_extremum`] is empty unless `finds_extrema`.
    fn sample_rows(
        &self,
        _extent: &Extent,
        _finds_extrema: bool,
        _call: &mut dyn FnMut(SampleRow<'_>),
    ) -> Result<bool, GenError> {
        Ok(false)
    }

    /// Calls with each sample inside a rectangle, its edges included, that [`Self::height_m`] interpolates between. A
    /// formula has no samples.
    fn samples_in(&self, _extent: &Extent, _call: &mut dyn FnMut(SourceSample)) -> Result<(), GenError> {
        Ok(())
    }

    /// Returns true for a formula, which is computed at any distance of samples, also beyond the rectangle of a set, and reads no
    /// files.
    fn is_formula(&self) -> bool {
        false
    }

    /// Announces that heights in a rectangle will be asked for. A source on a server reads them ahead.
    fn prepare(&self, _extent: &Extent) {}

    /// Returns false if the source has no data anywhere in a rectangle. True if it may have.
    fn may_have_data_in(&self, _extent: &Extent) -> bool {
        true
    }
}

/// Samples of a source at one latitude.
#[derive(Clone, Copy, Debug)]
pub struct SampleRow<'a> {
    /// The latitude in radians.
    pub latitude: f64,
    /// The longitudes in radians, the same in all rows of a call.
    pub longitudes: &'a [f64],
    /// The heights in metres above the ellipsoid, NaN for samples without data.
    pub heights_m: &'a [f32],
    /// [`SourceSample::is_extremum`] of each sample.
    pub is_extremum: &'a [bool],
}

/// A sample of a source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceSample {
    /// The longitude in radians.
    pub longitude: f64,
    /// The latitude in radians.
    pub latitude: f64,
    /// The height in metres above the ellipsoid.
    pub height_m: f64,
    /// True if it is higher, or lower, than each of its neighbours.
    pub is_extremum: bool,
}
