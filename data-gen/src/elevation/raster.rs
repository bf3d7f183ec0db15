//! One elevation raster: its samples, decoded by blocks when they are needed, its position on the earth, and interpolation
//! between samples.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use terrane::math::Ellipsoid;

use super::context::{DEFAULT_CACHE_BYTES, SourceContext};
use super::formats::{self, Opened, RasterOptions};
use crate::GenError;
use crate::georeference::{Placement, ROUNDING};
use crate::store::{BlockCache, BlockReader, Cursor, PixelImage, Rect, is_remote};

/// Heights above this are taken for missing data, such as the lowest number of a format. Heights in decimetres are below
/// it.
const MAX_ABS_HEIGHT_M: f32 = 100_000.0;

/// One elevation file, opened.
pub struct Raster {
    /// The heights in metres above the ellipsoid, north row first; NaN where unknown.
    image: PixelImage,
    width: usize,
    height: usize,
    /// The number of columns once around the earth; `None` if the raster does not reach around it.
    around: Option<usize>,
    placement: Placement,
    /// See [`Raster::bounds`].
    bounds: [f64; 4],
    path: PathBuf,
}

/// Completes the blocks of a file: impossible heights count as unknown, and the height of the geoid is added.
struct Heights {
    path: PathBuf,
    file: Box<dyn BlockReader>,
    placement: Placement,
    context: Arc<SourceContext>,
}

impl BlockReader for Heights {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let mut pixels = self.file.read(block)?;
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        if self.context.geoid.is_none() {
            for pixel in &mut pixels {
                let height_m = f32::from_bits(*pixel);
                let height_m = if height_m.abs() <= MAX_ABS_HEIGHT_M { height_m } else { f32::NAN };
                *pixel = height_m.to_bits();
                // Comparisons with NaN are false.
                low = if height_m < low { height_m } else { low };
                high = if height_m > high { height_m } else { high };
            }
            self.context.seen.add([low, high]);
            return Ok(pixels);
        }
        for (k, pixel) in pixels.iter_mut().enumerate() {
            let mut height_m = f32::from_bits(*pixel);
            if height_m.is_nan() || height_m.abs() > MAX_ABS_HEIGHT_M {
                *pixel = f32::NAN.to_bits();
                continue;
            }
            if let Some(geoid) = &self.context.geoid {
                let (column, row) = (block.column + k % block.width, block.row + k / block.width);
                let [longitude, latitude] = self.placement.longitude_latitude(column as f64 + 0.5, row as f64 + 0.5);
                let Some(undulation_m) = geoid.height_m(longitude, latitude) else {
                    return Err(GenError::invalid(&self.path, "reaches beyond the geoid grid of --vertical-datum"));
                };
                height_m = (f64::from(height_m) + undulation_m) as f32;
                *pixel = height_m.to_bits();
            }
            (low, high) = (low.min(height_m), high.max(height_m));
        }
        self.context.seen.add([low, high]);
        Ok(pixels)
    }

    fn is_known_empty(&self, block: Rect) -> bool {
        self.file.is_known_empty(block)
    }
}

impl Raster {
    /// Opens an elevation file. Its format is recognised by its first bytes, HGT by the extension of its name.
    pub fn read(path: &Path) -> Result<Self, GenError> {
        Self::read_in(path, &RasterOptions::default())
    }

    /// Like [`Raster::read`], with what the file does not say itself. Opens a folder of web tiles as well. Samples are decoded
    /// when they are needed, and a number of them stays in memory. A raster without any height is an error.
    pub fn read_in(path: &Path, options: &RasterOptions) -> Result<Self, GenError> {
        let context = SourceContext::new(Arc::new(BlockCache::new(DEFAULT_CACHE_BYTES)), None, None);
        let raster = Self::open(path, options, &context)?;
        if raster.has_heights()? { Ok(raster) } else { Err(raster.without_heights()) }
    }

    /// Opens an elevation file or a folder of web tiles and reads its header.
    pub(crate) fn open(path: &Path, options: &RasterOptions, context: &Arc<SourceContext>) -> Result<Self, GenError> {
        let mut opened = formats::open(path, options, context)?;
        if let Some(grid) = &context.datum_grid {
            let shifted = opened.placement.shifted_by(grid, opened.grid.size);
            opened.placement = shifted.map_err(|reason| GenError::invalid(path, reason))?;
        }
        Ok(Self::of(path, opened, context))
    }

    /// Returns the coarsest overview of the file whose samples are at most as far apart as `step`, east and north, in radians.
    /// `None` if it has none.
    pub(crate) fn overview(
        &self,
        step: [f64; 2],
        options: &RasterOptions,
        context: &Arc<SourceContext>,
    ) -> Result<Option<Self>, GenError> {
        let own = self.sample_distance();
        let factors = [0, 1].map(|axis| step[axis] / own[axis]);
        let opened = formats::open_overview(&self.path, factors, options, context, &self.placement)?;
        Ok(opened.map(|opened| Self::of(&self.path, opened, context)))
    }

    fn of(path: &Path, opened: Opened, context: &Arc<SourceContext>) -> Self {
        let Opened { grid, reader, placement } = opened;
        let heights =
            Heights { path: path.to_owned(), file: reader, placement: placement.clone(), context: Arc::clone(context) };
        let image = PixelImage::new(grid, Box::new(heights), &context.cache);
        let [width, height] = grid.size;
        let (bounds, path) = ([0.0; 4], path.to_owned());
        let mut raster = Self { image, width, height, around: None, placement, bounds, path };
        raster.around = raster.columns_around();
        raster.bounds = raster.measure_bounds();
        // A raster beyond 180 degrees of longitude is moved by a whole turn onto the earth; one around it has no ends.
        if raster.around.is_none() {
            raster.placement = raster.placement.clone().wrapped(raster.bounds);
            raster.bounds = raster.measure_bounds();
        }
        raster
    }

    /// Returns the error of a raster without heights.
    pub(crate) fn without_heights(&self) -> GenError {
        GenError::invalid(&self.path, "no sample has a height")
    }

    /// Returns the number of columns once around the earth if the raster reaches around it. Its last column may be the
    /// first one again.
    fn columns_around(&self) -> Option<usize> {
        let (middle, columns) = (0.5 * self.height as f64, self.width as f64);
        let longitude = |column: f64| self.placement.longitude_latitude(column, middle)[0];
        let wide = longitude(columns - 0.5) - longitude(0.5);
        let step = wide / (columns - 1.0);
        let is_north_up = self.placement.longitude_latitude(0.5, 0.5)[0] == longitude(0.5);
        let found = [self.width, self.width - 1].into_iter().find(|n| (step * *n as f64 - TAU).abs() < 0.01 * step);
        found.filter(|columns| is_north_up && *columns >= 4)
    }

    /// Returns true if any sample has a height. Blocks are decoded until one has.
    pub(crate) fn has_heights(&self) -> Result<bool, GenError> {
        let mut found = false;
        self.each_block(|heights| {
            found = heights.iter().any(|bits| f32::from_bits(*bits).is_finite());
            !found
        })?;
        Ok(found)
    }

    /// Returns the lowest and the highest sample in metres. All blocks are decoded.
    pub fn range_m(&self) -> Result<[f32; 2], GenError> {
        let mut range = [f32::INFINITY, f32::NEG_INFINITY];
        self.each_block(|heights| {
            let finite = heights.iter().map(|bits| f32::from_bits(*bits)).filter(|h| h.is_finite());
            range = finite.fold(range, |[low, high], h| [low.min(h), high.max(h)]);
            true
        })?;
        Ok(range)
    }

    /// Calls with the bits of the heights of each block that may have data, until the call returns false.
    fn each_block(&self, mut call: impl FnMut(&[u32]) -> bool) -> Result<(), GenError> {
        for rect in self.image.grid().rects().filter(|rect| !self.image.reader().is_known_empty(*rect)) {
            if !call(&self.image.block(rect.column, rect.row)?.1) {
                break;
            }
        }
        Ok(())
    }

    /// Adds a whole turn to the longitudes; the position on the earth stays the same.
    pub(crate) fn turn_east(&mut self) {
        if self.around.is_none() {
            self.placement = self.placement.clone().turned_east();
            self.bounds = self.measure_bounds();
        }
    }

    /// Returns the ellipsoid of the reference system; `None` for degrees without one.
    pub(crate) fn ellipsoid(&self) -> Option<Ellipsoid> {
        self.placement.ellipsoid()
    }

    /// Returns a note if the file has no georeference and a placement was assumed.
    pub(crate) fn note(&self) -> Option<String> {
        self.placement.note(&self.path)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the width and height in samples.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Returns west, south, east and north of the outermost samples in radians. A raster around the earth reaches from
    /// -180 to 180 degrees, and to the poles if its pixels do.
    pub fn bounds(&self) -> [f64; 4] {
        self.bounds
    }

    fn measure_bounds(&self) -> [f64; 4] {
        let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        let (w, h) = (self.width as f64, self.height as f64);
        for i in 0..=16 {
            let t = f64::from(i) / 16.0;
            let (c, r) = (0.5 + t * (w - 1.0), 0.5 + t * (h - 1.0));
            for (column, row) in [(c, 0.5), (c, h - 0.5), (0.5, r), (w - 0.5, r)] {
                let [lon, lat] = self.placement.longitude_latitude(column, row);
                b = [b[0].min(lon), b[1].min(lat), b[2].max(lon), b[3].max(lat)];
            }
        }
        if self.around.is_some() {
            let edges = [0.0, h].map(|row| self.placement.longitude_latitude(0.5, row)[1]);
            let [south, north] = [edges[0].min(edges[1]), edges[0].max(edges[1])];
            let is_pole = |edge: f64| (edge.abs() - FRAC_PI_2).abs() < ROUNDING;
            b = [
                -PI,
                if is_pole(south) { -FRAC_PI_2 } else { b[1] },
                PI,
                if is_pole(north) { FRAC_PI_2 } else { b[3] },
            ];
        }
        b
    }

    /// Returns the distance between samples along the longer sides of the bounds, east and north, in radians.
    pub(crate) fn sample_distance(&self) -> [f64; 2] {
        let [west, south, east, north] = self.bounds;
        let columns = self.around.unwrap_or(self.width.max(2) - 1);
        // Samples around the earth lie half a pixel from the poles.
        let rows =
            if self.around.is_some() && north - south > PI - ROUNDING { self.height } else { self.height.max(2) - 1 };
        [(east - west) / columns as f64, (north - south) / rows as f64]
    }

    /// Returns the columns that the raster has once around the earth, `None` if it has ends.
    pub(super) fn around(&self) -> Option<usize> {
        self.around
    }

    /// Returns true if the file is on a server.
    pub(super) fn is_remote(&self) -> bool {
        is_remote(&self.path)
    }

    /// Returns a cursor that reads samples.
    pub(crate) fn cursor(&self) -> Cursor<'_> {
        Cursor::new(&self.image)
    }

    pub(super) fn image(&self) -> &PixelImage {
        &self.image
    }

    /// Returns the column and row of a longitude and latitude in radians; whole numbers are pixel corners.
    pub(super) fn pixel(&self, longitude: f64, latitude: f64) -> Option<[f64; 2]> {
        self.placement.pixel(longitude, latitude)
    }

    /// Returns the longitude and latitude of a sample in radians, or of one beyond the edges.
    pub(super) fn position(&self, column: i64, row: i64) -> [f64; 2] {
        self.placement.longitude_latitude(column as f64 + 0.5, row as f64 + 0.5)
    }

    /// Locates a longitude and latitude in radians relative to the sample centres. `None` if the reference system has
    /// no coordinates there.
    pub(crate) fn locate(&self, longitude: f64, latitude: f64) -> Option<SamplePosition> {
        Some(self.locate_pixel(self.placement.pixel(longitude, latitude)?))
    }

    /// Locates a column and row, of which whole numbers are pixel corners, relative to the sample centres.
    fn locate_pixel(&self, [c, r]: [f64; 2]) -> SamplePosition {
        let mut at = [c - 0.5, r - 0.5];
        let mut last = [self.width as f64 - 1.0, self.height as f64 - 1.0];
        if let Some(columns) = self.around {
            // Rounding may give the number of columns itself.
            at[0] = at[0].rem_euclid(columns as f64);
            last[0] = columns as f64;
        }
        let nearest_px = [0, 1].map(|k| at[k].clamp(0.0, last[k]));
        // Less than a thousandth of a pixel outside is a rounding error.
        let beyond_px = [0, 1].map(|k| at[k] - nearest_px[k]).map(|b: f64| if b.abs() < 1e-3 { 0.0 } else { b });
        SamplePosition { nearest_px, beyond_px }
    }

    /// Interpolates between the four samples around a column and row. Samples without data are left out and the weights of
    /// the others scaled up; `None` if the nearest sample has no data.
    pub(crate) fn bilinear_m(&self, cursor: &mut Cursor<'_>, [x, y]: [f64; 2]) -> Result<Option<f64>, GenError> {
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let [i0, i1] = [0, 1].map(|dx| self.column(x0 as usize + dx));
        let [j0, j1] = [0, 1].map(|dy| (y0 as usize + dy).min(self.height - 1));
        let samples = cursor.corners([i0, i1], [j0, j1])?.map(|bits| f64::from(f32::from_bits(bits)));
        Ok(weighted_m(samples, [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy]))
    }

    /// Returns true if columns are meridians and rows are parallels, and the raster has ends.
    pub(super) fn has_straight_axes(&self) -> bool {
        self.around.is_none() && self.placement.has_straight_axes()
    }

    /// Computes those heights along a row of positions ([`heights_of_row`](super::ElevationSource::heights_of_row)) that are NaN so far, where
    /// `is_wanted` is true for the position.
    pub(super) fn fill_row(
        &self,
        cursor: &mut Cursor<'_>,
        [longitude, step, latitude]: [f64; 3],
        out: &mut [f32],
        mut is_wanted: impl FnMut(usize, &SamplePosition) -> bool,
    ) -> Result<(), GenError> {
        let row = self.placement.row(latitude);
        for (k, height_m) in out.iter_mut().enumerate().filter(|(_, h)| h.is_nan()) {
            let Some(pixel) = row.pixel(longitude + step * k as f64) else { continue };
            let position = self.locate_pixel(pixel);
            if is_wanted(k, &position)
                && let Some(found) = self.bilinear_m(cursor, position.nearest_px)?
            {
                *height_m = found as f32;
            }
        }
        Ok(())
    }

    /// Returns the column of a sample: the last one, or the first again, if `column` is beyond the last.
    fn column(&self, column: usize) -> usize {
        self.around.map_or(column.min(self.width - 1), |columns| column % columns)
    }

    /// Returns a column's step east and a row's step north at the centre, in radians. `None` if the raster is rotated
    /// so far that its columns run north rather than east.
    pub(crate) fn steps(&self) -> Option<[f64; 2]> {
        let (c, r) = (0.5 * self.width as f64, 0.5 * self.height as f64);
        let step = |[dc, dr]: [f64; 2]| {
            let [a, b] = self.placement.longitude_latitude(c - dc, r - dr);
            let [x, y] = self.placement.longitude_latitude(c + dc, r + dr);
            [x - a, y - b]
        };
        let (column, row) = (step([0.5, 0.0]), step([0.0, 0.5]));
        (column[0].abs() > column[1].abs() && row[1].abs() > row[0].abs()).then_some([column[0], row[1]])
    }
}

/// Returns the mean of samples with weights. Samples without data are left out; `None` if the one of the most weight has none.
pub(super) fn weighted_m(samples: [f64; 4], weights: [f64; 4]) -> Option<f64> {
    let (mut sum, mut total, mut nearest) = (0.0, 0.0, (0.0, f64::NAN));
    for (sample, weight) in samples.into_iter().zip(weights) {
        if weight > nearest.0 {
            nearest = (weight, sample);
        }
        if weight > 0.0 && sample.is_finite() {
            sum += weight * sample;
            total += weight;
        }
    }
    nearest.1.is_finite().then(|| sum / total)
}

/// A position relative to the sample centres of a raster.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SamplePosition {
    /// The nearest column and row inside the rectangle of the sample centres; whole numbers are centres.
    pub nearest_px: [f64; 2],
    /// Columns and rows from there to the position; 0 along an axis on which it lies inside the rectangle.
    pub beyond_px: [f64; 2],
}

impl SamplePosition {
    /// Returns true if the position lies inside the rectangle of the sample centres.
    pub fn is_inside(&self) -> bool {
        self.beyond_px == [0.0; 2]
    }

    /// Returns true if the position lies inside the raster. The area of the outermost samples ends half a pixel beyond
    /// their centres; the excess over 0.5 allows for rounding.
    pub fn is_covered(&self) -> bool {
        (0..2).all(|axis| self.is_covered_along(axis))
    }

    /// Returns true if the position lies inside the raster along an axis.
    pub fn is_covered_along(&self, axis: usize) -> bool {
        self.beyond_px[axis].abs() <= 0.501
    }
}
