//! The affine map from the pixels of a raster to coordinates in its reference system.

/// Maps pixel corners to the reference system: `origin + column * dx + row * dy`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GeoTransform {
    pub origin: [f64; 2],
    pub dx: [f64; 2],
    pub dy: [f64; 2],
}

impl GeoTransform {
    /// Returns the coordinates of a column and row. Whole numbers are pixel corners.
    pub fn at(&self, column: f64, row: f64) -> [f64; 2] {
        [0, 1].map(|k| self.origin[k] + column * self.dx[k] + row * self.dy[k])
    }

    /// Returns the column and row of coordinates, `None` for a singular transform. Whole numbers are pixel corners.
    pub fn pixel(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let determinant = self.dx[0] * self.dy[1] - self.dy[0] * self.dx[1];
        let (u, v) = (x - self.origin[0], y - self.origin[1]);
        let p = [(u * self.dy[1] - v * self.dy[0]) / determinant, (v * self.dx[0] - u * self.dx[1]) / determinant];
        p.iter().all(|c| c.is_finite()).then_some(p)
    }
}
