//! Projections and datums of EPSG, and projections of other bodies, by PROJ's formulas (crate `proj4rs`), from definitions in PROJ's notation.
//!
//! Datum shifts by parameters (`+towgs84`) are applied; those by grids if the user names one ([`super::DatumGrid`]).

use std::sync::Arc;

use proj4rs::Proj;
use proj4rs::transform::transform;
use terrane::math::{Ellipsoid, WGS84};

/// Equatorial radii of the earth's ellipsoids, metres.
pub(super) const EARTH_AXES_M: std::ops::Range<f64> = 6.3e6..6.5e6;

/// The names of the grids that [`super::DatumGrid`] reads begin so.
pub(super) const OWN_GRID: &str = "terrane";

/// A reference system with a definition in PROJ's notation. Coordinates are degrees, or the system's unit of length.
#[derive(Clone, Debug)]
pub struct Projection {
    definition: Arc<str>,
    systems: Arc<Systems>,
}

#[derive(Debug)]
struct Systems {
    own: Proj,
    /// Longitude and latitude on WGS84, or on the ellipsoid of another body.
    geodetic: Proj,
    ellipsoid: Ellipsoid,
}

impl PartialEq for Projection {
    fn eq(&self, other: &Self) -> bool {
        self.definition == other.definition
    }
}

impl Projection {
    /// Creates a system from a definition such as `+proj=laea +lat_0=52 +lon_0=10`. The error is the reason.
    ///
    /// Grids that only PROJ has are left out. NAD27 is shifted by the parameters for the contiguous United States then
    /// (EPSG:1173), which are good to ten metres there.
    pub fn new(definition: &str) -> Result<Self, String> {
        // The crate cuts angles at bytes, which panics inside of other characters. It reads `d` as the sign of degrees.
        let definition = &*definition.replace('°', "d");
        if let Some(other) = definition.chars().find(|c| !c.is_ascii()) {
            return Err(format!("a definition with the character `{other}`; ASCII and the sign of degrees are read"));
        }
        let is_known =
            |part: &&str| !part.starts_with("+nadgrids=") || part.contains(OWN_GRID) || part.contains("@null");
        // WKT and GeoTIFF write the inverse flattening of spheres as 0.
        let is_sphere = |part: &&str| {
            let number = part.strip_prefix("+rf=").and_then(|number| number.parse::<f64>().ok());
            number.is_some_and(|number| number == 0.0 || number.is_infinite())
        };
        let parts = definition.split_whitespace().filter(is_known).filter(|part| !is_sphere(part));
        let has_grid = definition.contains(OWN_GRID);
        let parts = parts.map(|part| match part {
            "+datum=NAD27" if has_grid => "+ellps=clrk66",
            "+datum=NAD27" => "+ellps=clrk66 +towgs84=-8,160,176",
            part => part,
        });
        let definition = &*parts.collect::<Vec<_>>().join(" ");
        let bad = |e: proj4rs::errors::Error| format!("`{definition}`: {e}");
        let own = Proj::from_proj_string(definition).map_err(bad)?;
        if own.is_geocent() || !own.has_inverse() || !own.has_forward() {
            return Err(format!("`{definition}`: only geographic and projected systems with an inverse are supported"));
        }
        let (axis_m, minor_m) = own.ellipse_parameters();
        let (ellipsoid, geodetic) = match EARTH_AXES_M.contains(&axis_m) {
            true => (WGS84, "+proj=longlat +datum=WGS84".to_owned()),
            false => {
                let ellipsoid = Ellipsoid::from_radii_m([axis_m, axis_m, minor_m]);
                let ellipsoid = ellipsoid.map_err(|error| format!("`{definition}`: {error}"))?;
                (ellipsoid, format!("+proj=longlat +a={axis_m} +b={minor_m}"))
            }
        };
        let geodetic = Proj::from_proj_string(&geodetic).map_err(bad)?;
        Ok(Self { definition: definition.into(), systems: Arc::new(Systems { own, geodetic, ellipsoid }) })
    }

    /// Returns the ellipsoid that longitudes and latitudes are on: WGS84, or that of another body.
    pub(super) fn ellipsoid(&self) -> Ellipsoid {
        self.systems.ellipsoid
    }

    /// Returns true if coordinates are longitude and latitude in degrees and nothing else is defined but an ellipsoid.
    pub(super) fn is_plain_degrees(&self) -> bool {
        const KEYS: [&str; 9] =
            ["+proj=longlat", "+a=", "+b=", "+R=", "+rf=", "+f=", "+no_defs", "+type=crs", "+units="];
        self.definition.split_whitespace().all(|part| KEYS.iter().any(|key| part.starts_with(key)))
    }

    /// Returns the same system with the shift of a grid to WGS84, which has a name for `proj4rs`. `None` if its datum is WGS84 or
    /// one that is read as the same. The error is the reason.
    pub(super) fn with_grid(&self, name: &str) -> Result<Option<Self>, String> {
        let parts = || self.definition.split_whitespace();
        let value = |key: &str| parts().find_map(|part| part.strip_prefix(key));
        let of_datum = value("+datum=").and_then(ellipsoid_of);
        let is_shifted = value("+towgs84=").is_some_and(|shift| shift.split(',').any(|n| n.trim().parse() != Ok(0.0)));
        let is_foreign = value("+ellps=").is_some_and(|name| !matches!(name, "WGS84" | "GRS80"));
        if of_datum.is_none() && !is_shifted && !is_foreign && value("+nadgrids=").is_none() {
            return Ok(None);
        }
        let is_kept = |part: &&str| !["+towgs84=", "+datum=", "+nadgrids="].iter().any(|key| part.starts_with(key));
        let mut definition: Vec<String> = parts().filter(is_kept).map(str::to_owned).collect();
        definition.extend(of_datum.map(|ellipsoid| format!("+ellps={ellipsoid}")));
        definition.push(format!("+nadgrids={name}"));
        Self::new(&definition.join(" ")).map(Some)
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
        let Systems { own, geodetic, .. } = &*self.systems;
        let mut point = (longitude, latitude, 0.0);
        match transform(geodetic, own, &mut point) {
            Ok(()) if own.is_latlong() => [point.0.to_degrees(), point.1.to_degrees()],
            Ok(()) => [point.0, point.1],
            Err(_) => [f64::NAN; 2],
        }
    }

    /// Converts coordinates to a longitude and latitude on WGS84 in radians; NaN outside of the system.
    pub fn unproject(&self, x: f64, y: f64) -> [f64; 2] {
        let Systems { own, geodetic, .. } = &*self.systems;
        let mut point = if own.is_latlong() { (x.to_radians(), y.to_radians(), 0.0) } else { (x, y, 0.0) };
        match transform(own, geodetic, &mut point) {
            Ok(()) => [point.0, point.1],
            Err(_) => [f64::NAN; 2],
        }
    }
}

/// Returns the ellipsoid of a datum in PROJ's notation, if it is not that of WGS84 or nearly so.
fn ellipsoid_of(datum: &str) -> Option<&'static str> {
    Some(match datum {
        "potsdam" | "hermannskogel" => "bessel",
        "carthage" => "clrk80ign",
        "NAD27" => "clrk66",
        "ire65" => "mod_airy",
        "nzgd49" => "intl",
        "OSGB36" => "airy",
        _ => return None,
    })
}
