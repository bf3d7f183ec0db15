//! Where a raster lies: from its pixels to a reference system, and from there to the earth.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use crate::projection::Crs;
use crate::{GenError, geotiff};

/// Where files without any georeference are put: longitude and latitude of the north-west corner, and the pixel, in
/// degrees.
const DEFAULT_PLACE: ([f64; 2], f64) = ([8.0, 47.0], 1.0 / 3600.0);

/// Beyond 180 degrees by so little, radians, is at 180 degrees: files say their pixels in so many digits.
pub(crate) const ROUNDING: f64 = 1e-6;

/// From pixel corners to the reference system: `origin + column * dx + row * dy`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GeoTransform {
    pub origin: [f64; 2],
    pub dx: [f64; 2],
    pub dy: [f64; 2],
}

impl GeoTransform {
    /// Coordinates of a column and row, pixel corners integral.
    pub fn at(&self, column: f64, row: f64) -> [f64; 2] {
        [0, 1].map(|k| self.origin[k] + column * self.dx[k] + row * self.dy[k])
    }

    /// Column and row, pixel corners integral; `None` for a singular transform.
    pub fn pixel(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let determinant = self.dx[0] * self.dy[1] - self.dy[0] * self.dx[1];
        let (u, v) = (x - self.origin[0], y - self.origin[1]);
        let p = [(u * self.dy[1] - v * self.dy[0]) / determinant, (v * self.dx[0] - u * self.dx[1]) / determinant];
        p.iter().all(|c| c.is_finite()).then_some(p)
    }
}

/// A raster's place on the earth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    transform: GeoTransform,
    crs: Crs,
    /// Added to the longitudes of the system, radians: a whole turn for what lies beyond the date line.
    turn: f64,
}

impl Placement {
    pub fn new(transform: GeoTransform, crs: Crs) -> Self {
        Self { transform, crs, turn: 0.0 }
    }

    /// A turn back for what lies beyond 180 degrees as a whole, so that 190 is -170. What reaches across them, and what
    /// lies more than a turn away, stays.
    pub fn turned(self, [west, _, east, _]: [f64; 4]) -> Self {
        let within = |turn: f64| west + turn >= -PI - ROUNDING && east + turn <= PI + ROUNDING;
        let turn = [0.0, -TAU, TAU].into_iter().find(|turn| within(*turn));
        Self { turn: self.turn + turn.unwrap_or(0.0), ..self }
    }

    /// A turn further east.
    pub fn turned_east(self) -> Self {
        Self { turn: self.turn + TAU, ..self }
    }

    /// Longitude and latitude in radians of a column and row, pixel corners integral.
    pub fn place(&self, column: f64, row: f64) -> [f64; 2] {
        let [x, y] = self.transform.at(column, row);
        let [longitude, latitude] = self.crs.unproject(x, y);
        [longitude + self.turn, latitude]
    }

    /// Column and row, pixel corners integral, of a longitude and latitude in radians.
    pub fn pixel(&self, longitude: f64, latitude: f64) -> Option<[f64; 2]> {
        self.transform.pixel(self.crs.project(longitude - self.turn, latitude))
    }

    /// By a TIFF's tags, else by the world file beside it; the system is the one it names, else `given`. `None` where
    /// there is neither.
    pub fn of_tiff(path: &Path, tiff: &geotiff::Tiff, given: Option<Crs>) -> Result<Option<Self>, GenError> {
        let Some(transform) = tiff.transform.or_else(|| world_file(path)) else { return Ok(None) };
        let named = tiff.keys.crs(given).map_err(|reason| GenError::invalid(path, reason))?;
        let crs = named.map_or_else(|| unnamed(path, &transform, [tiff.width, tiff.height], given), Ok)?;
        Ok(Some(Self::new(transform, crs)))
    }

    /// By the world file beside a picture, in the system that is `given`; without one at the default place.
    pub fn of_picture(path: &Path, size: [usize; 2], given: Option<Crs>) -> Result<Self, GenError> {
        match world_file(path) {
            Some(transform) => Ok(Self::new(transform, unnamed(path, &transform, size, given)?)),
            None => Ok(Self::default()),
        }
    }
}

impl Default for Placement {
    fn default() -> Self {
        let (origin, pixel) = DEFAULT_PLACE;
        Self::new(GeoTransform { origin, dx: [pixel, 0.0], dy: [0.0, -pixel] }, Crs::Geographic)
    }
}

/// The system of a raster that names none: the `given` one, else degrees, if they can be.
fn unnamed(
    path: &Path,
    transform: &GeoTransform,
    [width, height]: [usize; 2],
    given: Option<Crs>,
) -> Result<Crs, GenError> {
    if let Some(crs) = given {
        return Ok(crs);
    }
    // Sample centres; longitudes may count from 0 to 360.
    let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
    for (column, row) in [(0.5, 0.5), (right, 0.5), (0.5, bottom), (right, bottom)] {
        let [x, y] = transform.at(column, row);
        let is_place = x.abs() <= 360.0 && y.abs() <= 90.0 + 1e-6;
        if !is_place {
            let reason = format!("names no reference system, and {x}, {y} are no degrees; --epsg CODE names it");
            return Err(GenError::invalid(path, reason));
        }
    }
    Ok(Crs::Geographic)
}

/// The world file beside a picture: .pgw, .wld and the like.
fn world_file(path: &Path) -> Option<GeoTransform> {
    for extension in ["pgw", "jgw", "tfw", "wld", "exw"] {
        let Ok(text) = std::fs::read_to_string(path.with_extension(extension)) else { continue };
        let n: Vec<f64> = text.split_whitespace().filter_map(|t| t.parse().ok()).collect();
        if let [a, d, b, e, x, y] = n[..] {
            let origin = [x - 0.5 * (a + b), y - 0.5 * (d + e)];
            return Some(GeoTransform { origin, dx: [a, d], dy: [b, e] });
        }
    }
    None
}
