//! The interface between elevation data and the sampling of the grid.

/// Heights as a function of position. Called from several threads at the same time.
pub trait ElevationSource: Sync {
    /// Returns the height in metres above the ellipsoid at a longitude and latitude in radians, `None` where the
    /// source has no data.
    fn height_m(&self, longitude: f64, latitude: f64) -> Option<f64>;
}
