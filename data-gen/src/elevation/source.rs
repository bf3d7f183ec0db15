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

    /// Calls with each sample inside a rectangle, its edges included, that [`Self::height_m`] interpolates between. A
    /// formula has no samples.
    fn samples_in(&self, _extent: &Extent, _call: &mut dyn FnMut(SourceSample)) -> Result<(), GenError> {
        Ok(())
    }

    /// Announces that heights in a rectangle will be asked for. A source on a server reads them ahead.
    fn prepare(&self, _extent: &Extent) {}

    /// Returns false if the source has no data anywhere in a rectangle. True if it may have.
    fn may_have_data_in(&self, _extent: &Extent) -> bool {
        true
    }
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
