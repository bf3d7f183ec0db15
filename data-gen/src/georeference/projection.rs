//! Projections and datums of EPSG by PROJ's formulas (crate `proj4rs`), from definitions in PROJ's notation.
//!
//! Datum shifts by grids are not applied; those by parameters (`+towgs84`) are.

use std::sync::Arc;

use proj4rs::Proj;
use proj4rs::transform::transform;

/// A reference system with a definition in PROJ's notation. Coordinates are degrees, or the system's unit of length.
#[derive(Clone, Debug)]
pub struct Projection {
    definition: Arc<str>,
    systems: Arc<Systems>,
}

#[derive(Debug)]
struct Systems {
    own: Proj,
    wgs84: Proj,
}

impl PartialEq for Projection {
    fn eq(&self, other: &Self) -> bool {
        self.definition == other.definition
    }
}

impl Projection {
    /// Creates a system from a definition such as `+proj=laea +lat_0=52 +lon_0=10`. The error is the reason.
    pub fn new(definition: &str) -> Result<Self, String> {
        let bad = |e: proj4rs::errors::Error| format!("`{definition}`: {e}");
        let own = Proj::from_proj_string(definition).map_err(bad)?;
        if own.is_geocent() || !own.has_inverse() || !own.has_forward() {
            return Err(format!("`{definition}`: only geographic and projected systems with an inverse are supported"));
        }
        let wgs84 = Proj::from_proj_string("+proj=longlat +datum=WGS84").map_err(bad)?;
        Ok(Self { definition: definition.into(), systems: Arc::new(Systems { own, wgs84 }) })
    }

    /// Returns the size of the unit of coordinates in metres, `None` for degrees.
    pub fn unit_m(&self) -> Option<f64> {
        let own = &self.systems.own;
        (!own.is_latlong()).then(|| own.to_meter())
    }

    /// Returns the definition in PROJ's notation.
    pub fn definition(&self) -> &str {
        &self.definition
    }

    /// Converts a longitude and latitude on WGS84 in radians to coordinates; NaN where the system has none.
    pub fn project(&self, longitude: f64, latitude: f64) -> [f64; 2] {
        let Systems { own, wgs84 } = &*self.systems;
        let mut point = (longitude, latitude, 0.0);
        match transform(wgs84, own, &mut point) {
            Ok(()) if own.is_latlong() => [point.0.to_degrees(), point.1.to_degrees()],
            Ok(()) => [point.0, point.1],
            Err(_) => [f64::NAN; 2],
        }
    }

    /// Converts coordinates to a longitude and latitude on WGS84 in radians; NaN outside of the system.
    pub fn unproject(&self, x: f64, y: f64) -> [f64; 2] {
        let Systems { own, wgs84 } = &*self.systems;
        let mut point = if own.is_latlong() { (x.to_radians(), y.to_radians(), 0.0) } else { (x, y, 0.0) };
        match transform(own, wgs84, &mut point) {
            Ok(()) => [point.0, point.1],
            Err(_) => [f64::NAN; 2],
        }
    }
}
