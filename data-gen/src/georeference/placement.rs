//! The placement of a raster on the earth: from its pixels to a reference system, and from there to longitude and
//! latitude.

use std::f64::consts::{PI, TAU};
use std::path::Path;
use std::sync::Arc;

use terrane::math::Ellipsoid;

use super::beside::{Metadata, system_file, world_file};
use super::crs::Crs;
use super::geotiff::Tiff;
use super::grids::DatumGrid;
use super::transform::GeoTransform;
use crate::GenError;
use crate::store::BlockCache;

/// The placement of files without a georeference: longitude and latitude of the north-west corner, and the pixel size,
/// in degrees.
const DEFAULT_PLACEMENT: ([f64; 2], f64) = ([8.0, 47.0], 1.0 / 3600.0);

/// Longitudes beyond 180 degrees by at most this, in radians, count as 180 degrees: files round their pixel sizes.
pub(crate) const ROUNDING: f64 = 1e-6;

/// Converts between the pixels of a raster and longitude and latitude.
#[derive(Clone, Debug)]
pub(crate) struct Placement {
    transform: GeoTransform,
    crs: Crs,
    /// Added to the longitudes of the system, in radians: 0 or a whole turn, for rasters beyond the date line.
    turn: f64,
    /// True for the placement of files without a georeference.
    is_assumed: bool,
}

impl Placement {
    pub fn new(transform: GeoTransform, crs: Crs) -> Self {
        Self { transform, crs, turn: 0.0, is_assumed: false }
    }

    /// Moves a raster that lies beyond 180 degrees as a whole back by a turn, so that 190 becomes -170. A raster across
    /// 180 degrees, or more than one turn away, stays. `bounds` are its west, south, east and north in radians.
    pub fn wrapped(self, bounds: [f64; 4]) -> Self {
        let [west, _, east, _] = bounds;
        let within = |turn: f64| west + turn >= -PI - ROUNDING && east + turn <= PI + ROUNDING;
        let turn = [0.0, -TAU, TAU].into_iter().find(|turn| within(*turn));
        Self { turn: self.turn + turn.unwrap_or(0.0), ..self }
    }

    /// Returns a note about a file if it has no georeference and a placement was assumed.
    pub fn note(&self, path: &Path) -> Option<String> {
        let ([west, north], _) = DEFAULT_PLACEMENT;
        let text = || {
            format!(
                "{}: no georeference; its north-western corner is taken to be at {west} degrees east and {north} degrees north, its \
                 pixels to be a second of arc; a world file places it",
                path.display()
            )
        };
        self.is_assumed.then(text)
    }

    /// Returns [`Crs::ellipsoid`] of the reference system.
    pub fn ellipsoid(&self) -> Option<Ellipsoid> {
        self.crs.ellipsoid()
    }

    /// Adds a whole turn to the longitudes.
    pub fn turned_east(self) -> Self {
        Self { turn: self.turn + TAU, ..self }
    }

    /// Returns the placement of an image of a size in a system that a grid shifts to WGS84, unless the system's datum is WGS84.
    /// The error is the reason.
    pub fn shifted_by(self, grid: &DatumGrid, size: [usize; 2]) -> Result<Self, String> {
        let Crs::Projection(projection) = &self.crs else { return Ok(self) };
        let Some(shifted) = projection.with_grid(&grid.name)? else { return Ok(self) };
        let shifted = Self { crs: Crs::Projection(shifted), ..self };
        grid.set_used();
        let [width, height] = size.map(|side| side as f64);
        let corners = [[0.5, 0.5], [width - 0.5, 0.5], [0.5, height - 0.5], [width - 0.5, height - 0.5]];
        let is_inside = |[column, row]: [f64; 2]| shifted.longitude_latitude(column, row).iter().all(|c| c.is_finite());
        match corners.into_iter().all(is_inside) {
            true => Ok(shifted),
            false => Err("reaches beyond the grid of --datum-grid".to_owned()),
        }
    }

    /// Returns the placement of the same image with pixels that are wider and higher by factors.
    pub fn scaled(&self, [wider, higher]: [f64; 2]) -> Self {
        let GeoTransform { origin, dx, dy } = self.transform;
        let transform = GeoTransform { origin, dx: dx.map(|d| d * wider), dy: dy.map(|d| d * higher) };
        Self { transform, ..self.clone() }
    }

    /// Returns the placement of an image with another transform in the same reference system.
    pub fn with_transform(&self, transform: GeoTransform) -> Self {
        Self { transform, ..self.clone() }
    }

    /// Returns the longitude and latitude in radians of a column and row. Whole numbers are pixel corners.
    pub fn longitude_latitude(&self, column: f64, row: f64) -> [f64; 2] {
        let [x, y] = self.transform.at(column, row);
        let [longitude, latitude] = self.crs.unproject(x, y);
        [longitude + self.turn, latitude]
    }

    /// Returns the column and row of a longitude and latitude in radians. Whole numbers are pixel corners.
    pub fn pixel(&self, longitude: f64, latitude: f64) -> Option<[f64; 2]> {
        self.transform.pixel(self.crs.project(longitude - self.turn, latitude))
    }

    /// Returns true if a column depends on the longitude alone, and a row on the latitude.
    pub fn has_straight_axes(&self) -> bool {
        let GeoTransform { dx, dy, .. } = self.transform;
        dx[1] == 0.0 && dy[0] == 0.0 && self.crs.y_of_latitude(0.0).is_some()
    }

    /// Returns the row of positions at a latitude in radians.
    pub fn row(&self, latitude: f64) -> PixelRow<'_> {
        PixelRow { placement: self, latitude, y: self.crs.y_of_latitude(latitude) }
    }

    /// Positions a TIFF by its tags and its metadata, or by the world file beside it if they do not; `None` without all of
    /// them. `given` is the reference system of files that do not name one.
    pub fn of_tiff(
        path: &Path,
        tiff: &Tiff,
        given: Option<Crs>,
        cache: &Arc<BlockCache>,
    ) -> Result<Option<Self>, GenError> {
        let transform = match tiff.metadata.transform.or(tiff.transform) {
            Some(transform) => transform,
            None => match world_file(path, cache)? {
                Some(transform) => transform,
                None => return Ok(None),
            },
        };
        let keyed = tiff.keys.crs(given.clone());
        let fallback = keyed.as_ref().ok().and_then(Option::as_ref).or(given.as_ref());
        let named = match tiff.metadata.crs(fallback)? {
            Some(crs) => Some(crs),
            None => keyed.map_err(|reason| GenError::invalid(path, reason))?,
        };
        let size = [tiff.width, tiff.height];
        let unnamed = || unnamed_crs(path, &transform, size, given, &Metadata::default(), cache);
        let crs = named.map_or_else(unnamed, Ok)?;
        Ok(Some(Self::new(transform, crs)))
    }

    /// Positions a raster with a transform that names no reference system: in that of the files beside it, or in the system
    /// `given`, or in degrees if its coordinates can be degrees.
    pub fn of_unnamed(
        path: &Path,
        transform: GeoTransform,
        size: [usize; 2],
        given: Option<Crs>,
        cache: &Arc<BlockCache>,
    ) -> Result<Self, GenError> {
        Self::of_header(path, transform, size, given, &Metadata::beside(path, cache)?, cache)
    }

    /// Like [`Placement::of_unnamed`], with metadata from elsewhere.
    pub fn of_header(
        path: &Path,
        transform: GeoTransform,
        size: [usize; 2],
        given: Option<Crs>,
        metadata: &Metadata,
        cache: &Arc<BlockCache>,
    ) -> Result<Self, GenError> {
        Ok(Self::new(transform, unnamed_crs(path, &transform, size, given, metadata, cache)?))
    }

    /// Positions an image by the tags of a TIFF inside of its file. `None` if they have no transform.
    pub fn of_embedded(
        path: &Path,
        tiff: &[u8],
        size: [usize; 2],
        given: Option<Crs>,
        cache: &Arc<BlockCache>,
    ) -> Result<Option<Self>, GenError> {
        let bad = |reason: String| GenError::invalid(path, reason);
        let (transform, keys) = Tiff::embedded(tiff).map_err(bad)?;
        let Some(transform) = transform else { return Ok(None) };
        match keys.crs(given.clone()).map_err(bad)? {
            Some(crs) => Ok(Some(Self::new(transform, crs))),
            None => Self::of_header(path, transform, size, given, &Metadata::beside(path, cache)?, cache).map(Some),
        }
    }

    /// Positions a virtual raster by its metadata. `None` if it has no transform.
    pub fn of_virtual(
        path: &Path,
        metadata: &Metadata,
        size: [usize; 2],
        given: Option<Crs>,
        cache: &Arc<BlockCache>,
    ) -> Result<Option<Self>, GenError> {
        let at = |transform| Self::of_header(path, transform, size, given, metadata, cache);
        metadata.transform.map(at).transpose()
    }

    /// Positions an image by the metadata or the world file beside it, in the reference system that the files beside it name,
    /// or in the system `given`. `None` without such a file.
    pub fn of_image(
        path: &Path,
        size: [usize; 2],
        given: Option<Crs>,
        cache: &Arc<BlockCache>,
    ) -> Result<Option<Self>, GenError> {
        let metadata = Metadata::beside(path, cache)?;
        let transform = match metadata.transform {
            Some(transform) => transform,
            None => match world_file(path, cache)? {
                Some(transform) => transform,
                None => return Ok(None),
            },
        };
        let crs = unnamed_crs(path, &transform, size, given, &metadata, cache)?;
        Ok(Some(Self::new(transform, crs)))
    }
}

/// Positions at one latitude.
pub(crate) struct PixelRow<'a> {
    placement: &'a Placement,
    latitude: f64,
    /// The second coordinate in the reference system, if it depends on the latitude alone.
    y: Option<f64>,
}

impl PixelRow<'_> {
    /// Returns the column and row of a longitude in radians, the same as [`Placement::pixel`].
    pub fn pixel(&self, longitude: f64) -> Option<[f64; 2]> {
        let Placement { transform, crs, turn, .. } = self.placement;
        match self.y {
            Some(y) => transform.pixel([crs.x_of_longitude(longitude - turn), y]),
            None => self.placement.pixel(longitude, self.latitude),
        }
    }
}

impl Default for Placement {
    fn default() -> Self {
        let (origin, pixel) = DEFAULT_PLACEMENT;
        let transform = GeoTransform { origin, dx: [pixel, 0.0], dy: [0.0, -pixel] };
        Self { is_assumed: true, ..Self::new(transform, Crs::Geographic) }
    }
}

/// Returns the reference system of a raster that does not name one: that of the file beside it with the extension prj, that of
/// its metadata, `given`, or degrees if its coordinates can be degrees.
fn unnamed_crs(
    path: &Path,
    transform: &GeoTransform,
    [width, height]: [usize; 2],
    given: Option<Crs>,
    metadata: &Metadata,
    cache: &Arc<BlockCache>,
) -> Result<Crs, GenError> {
    if let Some(crs) = system_file(path, given.as_ref(), cache)? {
        return Ok(crs);
    }
    if let Some(crs) = metadata.crs(given.as_ref())?.or(given) {
        return Ok(crs);
    }
    // The corners of the rectangle of sample centres. Longitudes may range from 0 to 360.
    let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
    for (column, row) in [(0.5, 0.5), (right, 0.5), (0.5, bottom), (right, bottom)] {
        let [x, y] = transform.at(column, row);
        let is_in_degrees = x.abs() <= 360.0 && y.abs() <= 90.0 + 1e-6;
        if !is_in_degrees {
            let reason = format!("names no reference system, and {x}, {y} are not degrees; --epsg CODE names it");
            return Err(GenError::invalid(path, reason));
        }
    }
    Ok(Crs::Geographic)
}
