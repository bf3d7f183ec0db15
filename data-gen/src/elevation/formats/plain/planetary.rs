//! The maps of other bodies in labels of PDS4 and ISIS: a projection by its name, the position of the first pixel, and the size of
//! pixels. The thread that opens a file.

use crate::georeference::GeoTransform;

/// The smallest and the largest radius of a body in metres.
const RADII_M: std::ops::RangeInclusive<f64> = 1.0..=1e9;

/// A map in metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PlanetaryMap<'a> {
    pub projection: &'a str,
    /// The equatorial and the polar radius in metres.
    pub radii_m: [f64; 2],
    pub is_planetocentric: bool,
    /// True if longitudes increase to the west.
    pub is_west: bool,
    /// Longitude and latitude in degrees.
    pub center: [f64; 2],
    /// The latitude of Equirectangular with the true scale, in degrees.
    pub true_latitude: f64,
    /// The scale of Polar Stereographic at the pole.
    pub scale: f64,
    /// The north-western corner of the first pixel, and the width and the height of a pixel, in metres.
    pub corner_m: [f64; 2],
    pub pixel_m: [f64; 2],
}

impl PlanetaryMap<'_> {
    /// Returns the reference system in PROJ's notation. The error is the reason.
    pub fn system(&self) -> Result<String, String> {
        let [a, c] = self.radii_m;
        if !RADII_M.contains(&a) || !RADII_M.contains(&c) {
            return Err(format!("a body with the radii {a} and {c} m"));
        }
        if self.is_west {
            return Err("longitudes to the west, which are not supported".to_owned());
        }
        if self.is_planetocentric && a != c {
            return Err("planetocentric latitudes on an ellipsoid are not supported".to_owned());
        }
        let [longitude, latitude] = self.center;
        let name: String = self.projection.chars().filter(char::is_ascii_alphabetic).collect();
        let projection = match name.to_ascii_uppercase().as_str() {
            "SIMPLECYLINDRICAL" => "eqc +lat_ts=0".to_owned(),
            "EQUIRECTANGULAR" => format!("eqc +lat_ts={}", self.true_latitude),
            "POLARSTEREOGRAPHIC" => {
                format!("stere +lat_0={} +k={}", if latitude < 0.0 { -90 } else { 90 }, self.scale)
            }
            _ => {
                let name = self.projection.escape_debug();
                return Err(format!("the projection `{name}`; gdal_translate writes it as GeoTIFF"));
            }
        };
        Ok(format!("+proj={projection} +lon_0={longitude} +a={a} +b={c} +units=m"))
    }

    /// Returns the transform of pixels. The error is the reason.
    pub fn transform(&self) -> Result<GeoTransform, String> {
        let [dx, dy] = self.pixel_m;
        if !(dx > 0.0 && dy > 0.0) {
            return Err(format!("pixels of {dx} x {dy} m"));
        }
        Ok(GeoTransform { origin: self.corner_m, dx: [dx, 0.0], dy: [0.0, -dy] })
    }
}
