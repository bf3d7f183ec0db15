//! The interface between elevation data and the sampling of the grid.

/// Heights as a function of position. Called from several threads at the same time.
pub trait ElevationSource: Sync {
    /// Returns the height in metres above the ellipsoid at a longitude and latitude in radians, `None` where the
    /// source has no data.
    fn height_m(&self, longitude: f64, latitude: f64) -> Option<f64>;

    /// Returns the number of rows of samples that the source was measured at; 0 if it is a formula.
    fn sample_rows(&self) -> usize {
        0
    }

    /// Calls with the samples of a row that [`Self::height_m`] interpolates between.
    fn samples_of_row(&self, _row: usize, _call: &mut dyn FnMut(SourceSample)) {}
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
