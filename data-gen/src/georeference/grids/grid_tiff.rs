//! Grids of PROJ in the format GeoTIFF: one or more images of points over longitude and latitude, whose channels have names.

use std::path::Path;
use std::sync::Arc;

use super::super::geotiff::Tiff;
use crate::GenError;
use crate::store::BlockCache;

/// The largest number of points in a grid.
const MAX_POINTS: usize = 1 << 28;
/// The value of GTModelType for longitude and latitude.
const GEODETIC: u32 = 2;

/// An image of points.
pub(super) struct GridImage {
    tiff: Tiff,
    /// The longitude and latitude of the south-western point, and the distances of points, in degrees.
    pub south_west: [f64; 2],
    pub step: [f64; 2],
    /// Columns and rows.
    pub size: [usize; 2],
    is_north_first: bool,
}

/// Returns true for the first bytes of a TIFF.
pub(super) fn is_tiff(bytes: &[u8]) -> bool {
    matches!(bytes, [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..])
}

/// Opens the images of a grid. `kind` is the type of grids that are read; a grid of another type is an error.
pub(super) fn open(path: &Path, kind: &str) -> Result<Vec<GridImage>, GenError> {
    let first = Tiff::open(path, &Arc::new(BlockCache::new(0)))?;
    let found = first.item("name=\"TYPE\"", None);
    if let Some(found) = found.filter(|found| found != kind) {
        return Err(GenError::invalid(path, format!("a grid of the type {found}, not {kind}")));
    }
    let images = first.images()?.into_iter();
    images.map(|tiff| GridImage::of(tiff).map_err(|reason| GenError::invalid(path, reason))).collect()
}

impl GridImage {
    /// The error is the reason.
    fn of(tiff: Tiff) -> Result<Self, String> {
        if tiff.keys.model().is_some_and(|model| model != GEODETIC) {
            return Err("a grid over projected coordinates; longitude and latitude are supported".to_owned());
        }
        let t = tiff.transform.ok_or("no georeference")?;
        let size = [tiff.width, tiff.height];
        let is_valid = t.dx[0] > 0.0 && t.dy[1] != 0.0 && t.dx[1] == 0.0 && t.dy[0] == 0.0;
        if !is_valid || !t.origin.iter().chain([&t.dx[0], &t.dy[1]]).all(|n| n.is_finite()) {
            return Err("a grid that is turned, or without steps".to_owned());
        }
        if size[0] < 2 || size[1] < 2 || size[0].saturating_mul(size[1]) > MAX_POINTS {
            return Err(format!("{} x {} points; at most {MAX_POINTS} are supported", size[0], size[1]));
        }
        let is_north_first = t.dy[1] < 0.0;
        let [west, south] = t.at(0.5, if is_north_first { size[1] as f64 - 0.5 } else { 0.5 });
        // Longitudes may count from 0 to 360.
        let middle = west + 0.5 * t.dx[0] * (size[0] - 1) as f64;
        let west = west - 360.0 * ((middle + 180.0) / 360.0).floor();
        Ok(Self { south_west: [west, south], step: [t.dx[0], t.dy[1].abs()], size, is_north_first, tiff })
    }

    /// Returns the channel of one of some names.
    pub fn channel(&self, names: &[&str]) -> Option<usize> {
        self.descriptions().position(|name| name.is_some_and(|name| names.contains(&name.as_str())))
    }

    /// Returns true if a channel has a name. The images after the first one may leave the names out.
    pub fn has_names(&self) -> bool {
        self.descriptions().any(|name| name.is_some())
    }

    fn descriptions(&self) -> impl Iterator<Item = Option<String>> {
        (0..self.tiff.channels()).map(|channel| self.item("role=\"description\"", channel))
    }

    /// Returns the number of channels.
    pub fn channels(&self) -> usize {
        self.tiff.channels()
    }

    /// Returns a text of the metadata of a channel.
    pub fn item(&self, attribute: &str, channel: usize) -> Option<String> {
        self.tiff.item(attribute, Some(channel))
    }

    /// Returns a channel's values by their scale and offset, southern row first; NaN without data.
    pub fn values(&self, channel: usize, unit: f64) -> Result<Vec<f32>, GenError> {
        let mut values = Vec::with_capacity(self.size[0] * self.size[1]);
        let scaled = self.tiff.scale_and_offset(channel).map_err(|reason| self.tiff.bad(reason))?;
        let scaled = scaled.map(|n| n * unit);
        for rows in self.tiff.row_steps() {
            values.extend(self.tiff.samples(channel, None, rows, scaled)?);
        }
        if self.is_north_first {
            let rows = values.chunks_exact(self.size[0]).rev();
            values = rows.flatten().copied().collect();
        }
        Ok(values)
    }
}
