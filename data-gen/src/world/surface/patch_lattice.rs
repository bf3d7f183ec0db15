//! [`Lattice`]: where the samples of a patch lie on the planet.

/// Samples beyond each edge, for slopes and the shade of surroundings.
pub(crate) const MARGIN: usize = 4;

/// The rectangle of a patch: its cells are `step` radians of longitude and latitude, the first sample inside is at
/// `(column, row)` steps from the origin. Positions are computed from whole numbers, so that they have the same bits in all
/// patches.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    pub origin: [f64; 2],
    pub side: [f64; 2],
    /// The number of steps along the whole side.
    pub steps: f64,
    pub column: i64,
    pub row: i64,
    /// The radius of the body in metres.
    pub radius_m: f64,
}

impl Lattice {
    pub fn longitude(&self, column: i64) -> f64 {
        self.origin[0] + self.side[0] * ((self.column + column) as f64 / self.steps)
    }

    /// Returns the longitude of a place between samples.
    pub fn at_longitude(&self, column: f64) -> f64 {
        self.origin[0] + self.side[0] * ((self.column as f64 + column) / self.steps)
    }

    /// Returns the latitude of a place between samples.
    pub fn at_latitude(&self, row: f64) -> f64 {
        self.origin[1] + self.side[1] * ((self.row as f64 + row) / self.steps)
    }

    pub fn latitude(&self, row: i64) -> f64 {
        self.origin[1] + self.side[1] * ((self.row + row) as f64 / self.steps)
    }

    /// Returns the distance between rows in metres.
    pub fn step_m(&self) -> f64 {
        self.side[1] / self.steps * self.radius_m
    }
}
