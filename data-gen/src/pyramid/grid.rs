//! The heights of the grid: a square of vertices over a rectangle of longitude and latitude, `64 * 2^(levels-1)` cells a side.
//!
//! A height is a function of the vertex and the source, so that it has the same bits in every block and every run. It is the
//! source's height at the vertex, or that of the source's extremum nearest to the vertex, rounded to the quantum. Vertices
//! without data are filled by [`super::fill`].

use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use rayon::prelude::*;
use terrane::math::random::fnv1a;
use terrane::math::{Ellipsoid, WGS84};

use super::extrema::{Extrema, Extremum, parts};
use super::fill::{self, BOX, BoxMeans};
use super::samples::{HeightAt, Samples, Window};
use super::tile::{CELLS, TileKey};
use crate::{ElevationSource, Extent, GenError, SampleRow, Voids};

/// Heights are rounded to 1/128 m by default, so that a shared sample has the same bits in every tile and level.
pub const QUANTUM_M: f64 = 1.0 / 128.0;

/// The side of an aligned grid in radians: 64 cells of 2^15 seconds of arc.
const ALIGNED_SIDE: f64 = 64.0 * 32_768.0 / 3600.0 * std::f64::consts::PI / 180.0;
/// The rectangle of an aligned grid. It is larger than the earth.
pub(crate) const ALIGNED: Extent = Extent {
    west: -0.5 * ALIGNED_SIDE,
    south: -0.5 * ALIGNED_SIDE,
    east: 0.5 * ALIGNED_SIDE,
    north: 0.5 * ALIGNED_SIDE,
};
/// The heights in metres that stand for the lowest and the highest one in the colours of an aligned grid.
const ALIGNED_RANGE_M: [f32; 2] = [0.0, 3000.0];

/// Positions along a row are computed from the column of the last multiple of this number.
const SEGMENT: i64 = 64;
/// The cells along a side of the lattice for what depends on the whole set: a range of heights, and surroundings of wide gaps.
const COARSE_CELLS: i64 = 256;
/// The number of boxes whose averages are kept.
const MAX_BOXES: usize = 4096;

/// The depth of a lattice and the column and row of a box of it.
type BoxKey = (u32, i64, i64);

/// The heights of a grid. Threads share it.
pub(crate) struct Grid<'a> {
    source: &'a dyn ElevationSource,
    pub extent: Extent,
    /// The ellipsoid that longitudes and latitudes are on.
    pub ellipsoid: Ellipsoid,
    pub levels: u32,
    pub voids: Voids,
    /// Gives the vertices nearest to the source's highest and lowest samples their heights. The distance between vertices must
    /// be at most the source's.
    keep_extrema: bool,
    /// True if nothing depends on the whole source; see [`Self::aligned`].
    is_aligned: bool,
    /// The step in metres that heights are rounded to.
    step_m: f64,
    /// Rows from south to north; NaN where there is no data.
    coarse: OnceLock<Vec<f32>>,
    /// [`Self::coarse`] with its gaps filled.
    coarse_filled: OnceLock<Vec<f32>>,
    /// Averages of boxes that were computed before. Any thread locks it for the time of a look-up.
    boxes: Mutex<HashMap<BoxKey, Arc<BoxMeans>>>,
}

impl<'a> Grid<'a> {
    pub fn new(source: &'a dyn ElevationSource, extent: Extent, levels: u32, voids: Voids, keep_extrema: bool) -> Self {
        let (coarse, coarse_filled) = (OnceLock::new(), OnceLock::new());
        let boxes = Mutex::default();
        let (is_aligned, step_m, ellipsoid) = (false, QUANTUM_M, WGS84);
        Self {
            source,
            extent,
            ellipsoid,
            levels,
            voids,
            keep_extrema,
            is_aligned,
            step_m,
            coarse,
            coarse_filled,
            boxes,
        }
    }

    /// Returns the grid on another ellipsoid than the earth's.
    pub fn on(self, ellipsoid: Ellipsoid) -> Self {
        Self { ellipsoid, ..self }
    }

    /// Rounds heights to steps of another size than [`QUANTUM_M`].
    pub fn with_step(self, step_m: f64) -> Self {
        Self { step_m, ..self }
    }

    /// Returns the step in metres that heights are rounded to.
    pub fn step_m(&self) -> f64 {
        self.step_m
    }

    /// Creates a grid whose vertices do not depend on the source: seconds of arc and their halves, or several of them, around the
    /// whole earth. Boxes without data count as 0 m.
    pub fn aligned(source: &'a dyn ElevationSource, levels: u32, keep_extrema: bool) -> Self {
        let grid = Self::new(source, ALIGNED, levels, Voids::Cut, keep_extrema);
        Self { is_aligned: true, ..grid }
    }

    /// Returns true if the grid does not depend on the source.
    pub fn is_aligned(&self) -> bool {
        self.is_aligned
    }

    /// Returns the number of cells along a side of the lattice of a depth.
    pub fn cells(&self, depth: u32) -> i64 {
        ((CELLS as i64) << (self.levels - 1)) >> depth
    }

    fn longitude(&self, column: i64) -> f64 {
        let wide = self.extent.east - self.extent.west;
        let (first, cells) = (column & !(SEGMENT - 1), self.cells(0) as f64);
        self.extent.west + wide * (first as f64 / cells) + wide / cells * (column - first) as f64
    }

    fn latitude(&self, row: i64) -> f64 {
        self.extent.south + (self.extent.north - self.extent.south) * (row as f64 / self.cells(0) as f64)
    }

    /// Returns the rectangle of a window of the finest lattice.
    pub fn extent_of(&self, window: &Window) -> Extent {
        let Window { first, last } = *window;
        Extent {
            west: self.longitude(first[0]),
            south: self.latitude(first[1]),
            east: self.longitude(last[0]),
            north: self.latitude(last[1]),
        }
    }

    /// Returns the column and row of a longitude and latitude in radians, clamped to the grid.
    pub fn position(&self, longitude: f64, latitude: f64) -> [f64; 2] {
        let (e, cells) = (self.extent, self.cells(0) as f64);
        let (s, t) = ((longitude - e.west) / (e.east - e.west), (latitude - e.south) / (e.north - e.south));
        // Sample positions that coincide must do so in spite of rounding.
        let rounding = (cells * 1e-15).max(1e-7);
        [s, t].map(|c| (c * cells).clamp(0.0, cells)).map(|c| {
            let nearest = c.round();
            if (c - nearest).abs() < rounding { nearest } else { c }
        })
    }

    /// Returns the rectangle of a window of the finest lattice, widened by `margin` cells.
    fn extent_around(&self, window: &Window, margin: f64) -> Extent {
        let (e, cells) = (self.extent_of(window), self.cells(0) as f64);
        // Samples at an edge may lie beyond it by a rounding error.
        let [dx, dy] = [self.extent.east - self.extent.west, self.extent.north - self.extent.south]
            .map(|side| side / cells * (margin + 1e-3));
        Extent { west: e.west - dx, east: e.east + dx, south: e.south - dy, north: e.north + dy }
    }

    /// Like [`Self::source_samples`], with rows of samples, their columns and their row. Returns false, without a call, if the
    /// source has no rows.
    pub fn source_rows(
        &self,
        window: &Window,
        margin: f64,
        finds_extrema: bool,
        call: &mut dyn FnMut(&[f64], f64, SampleRow<'_>),
    ) -> Result<bool, GenError> {
        let mut columns: Vec<f64> = Vec::new();
        self.source.sample_rows(&self.extent_around(window, margin), finds_extrema, &mut |row| {
            if columns.is_empty() {
                columns.extend(row.longitudes.iter().map(|longitude| self.position(*longitude, row.latitude)[0]));
            }
            call(&columns, self.position(self.extent.west, row.latitude)[1], row);
        })
    }

    /// Calls with each sample of the source in a window of the finest lattice, widened by `margin` cells, and with its column
    /// and row.
    pub fn source_samples(
        &self,
        window: &Window,
        margin: f64,
        call: &mut dyn FnMut([f64; 2], crate::SourceSample),
    ) -> Result<(), GenError> {
        let extent = self.extent_around(window, margin);
        self.source.samples_in(&extent, &mut |sample| call(self.position(sample.longitude, sample.latitude), sample))
    }

    /// Returns false if the source has no data in a window of the lattice of a depth.
    pub fn may_have_data_in(&self, depth: u32, window: &Window) -> bool {
        let fine = |at: [i64; 2], beyond: i64| at.map(|c| ((c << depth) + beyond).clamp(0, self.cells(0)));
        // Extrema move by less than a cell.
        let window = Window { first: fine(window.first, -1), last: fine(window.last, 1) };
        self.source.may_have_data_in(&self.extent_of(&window))
    }

    /// Returns false if the source has no data in a tile.
    pub fn may_have_data_in_tile(&self, key: TileKey) -> bool {
        let side = CELLS as i64;
        let first = [key.x, key.y].map(|c| i64::from(c) * side);
        self.may_have_data_in(key.depth(self.levels), &Window { first, last: first.map(|c| c + side) })
    }

    /// Computes the heights in a window of the lattice of a depth. NaN marks vertices without data, also if they shall be sea.
    pub fn sample(&self, depth: u32, window: Window) -> Result<Samples, GenError> {
        let mut out = Samples::unknown(window);
        if !self.may_have_data_in(depth, &window) {
            return Ok(out);
        }
        let fine = |c: [i64; 2]| c.map(|c| c << depth);
        self.source.prepare(&self.extent_of(&Window { first: fine(window.first), last: fine(window.last) }));
        let width = window.width();
        let longitudes: Vec<f64> = (window.first[0]..=window.last[0]).map(|x| self.longitude(x << depth)).collect();
        let latitudes: Vec<f64> = (window.first[1]..=window.last[1]).map(|y| self.latitude(y << depth)).collect();
        if !self.source.heights_of_grid(&longitudes, &latitudes, &mut out.values)? {
            self.sample_rows(depth, &mut out)?;
        }
        if self.keep_extrema {
            self.keep_extrema(depth, &mut out)?;
        }
        let step_m = self.step_m;
        out.values.par_chunks_mut(width).for_each(|heights| {
            pulp::Arch::new().dispatch(
                #[inline(always)]
                || round(heights, step_m),
            );
        });
        Ok(out)
    }

    /// Samples a window row by row.
    fn sample_rows(&self, depth: u32, out: &mut Samples) -> Result<(), GenError> {
        let (window, width) = (out.window, out.window.width());
        out.values.par_chunks_mut(width).enumerate().try_for_each(|(row, heights)| {
            let latitude = self.latitude((window.first[1] + row as i64) << depth);
            if depth == 0 {
                self.sample_row(window.first[0], latitude, heights)
            } else {
                heights.iter_mut().enumerate().try_for_each(|(k, h)| {
                    let longitude = self.longitude((window.first[0] + k as i64) << depth);
                    *h = self.source.height_m(longitude, latitude)?.map_or(f32::NAN, |h| h as f32);
                    Ok(())
                })
            }
        })
    }

    /// Samples neighbouring vertices of a row, in segments that start at multiples of [`SEGMENT`].
    fn sample_row(&self, first: i64, latitude: f64, heights: &mut [f32]) -> Result<(), GenError> {
        let step = (self.extent.east - self.extent.west) / self.cells(0) as f64;
        let mut segment = [0.0f32; SEGMENT as usize];
        let mut done = 0;
        while done < heights.len() {
            let column = first + done as i64;
            let skipped = (column & (SEGMENT - 1)) as usize;
            let count = (SEGMENT as usize - skipped).min(heights.len() - done);
            let out = &mut heights[done..done + count];
            if skipped == 0 {
                self.source.heights_of_row(self.longitude(column), step, latitude, out)?;
            } else {
                let part = &mut segment[..skipped + count];
                self.source.heights_of_row(self.longitude(column - skipped as i64), step, latitude, part)?;
                out.copy_from_slice(&part[skipped..]);
            }
            done += count;
        }
        Ok(())
    }

    /// Replaces the heights of vertices that are nearest to an extremum of the source. If it is nearest to several, the
    /// nearest one counts.
    fn keep_extrema(&self, depth: u32, out: &mut Samples) -> Result<(), GenError> {
        let window = out.window;
        let in_part = |part: Window| {
            if !self.may_have_data_in(0, &part) {
                return Ok(Vec::new());
            }
            let mut found = Extrema::new(part);
            let has_rows = self.source_rows(&part, 0.5, true, &mut |columns, y, row| {
                for (k, x) in columns.iter().enumerate().filter(|(k, _)| row.is_extremum[*k]) {
                    found.add([*x, y], [row.longitudes[k], row.latitude], row.heights_m[k]);
                }
            })?;
            if !has_rows {
                self.source_samples(&part, 0.5, &mut |at, sample| {
                    if sample.is_extremum {
                        found.add(at, [sample.longitude, sample.latitude], sample.height_m as f32);
                    }
                })?;
            }
            Ok(found.found)
        };
        let found: Result<Vec<_>, GenError> = parts(depth, &window).into_par_iter().map(in_part).collect();
        let between = (1i64 << depth) - 1;
        for Extremum { at: [x, y], height_m, .. } in found?.into_iter().flatten() {
            // A strip has vertices of the finest lattice between its own.
            if (x | y) & between == 0 {
                out.set(x >> depth, y >> depth, height_m);
            }
        }
        Ok(())
    }

    /// Gives vertices without data a height of 0 if they shall be sea.
    pub fn flood(&self, samples: &mut Samples) {
        if self.voids == Voids::Sea {
            samples.values.iter_mut().filter(|h| h.is_nan()).for_each(|h| *h = 0.0);
        }
    }

    /// Computes the heights in a window of the lattice of a depth, without data for voids that are not sea.
    pub fn sample_flooded(&self, depth: u32, window: Window) -> Result<Samples, GenError> {
        let mut out = self.sample(depth, window)?;
        self.flood(&mut out);
        Ok(out)
    }

    /// Returns samples of the lattice of a depth with the vertices without data filled from their surroundings on that lattice.
    pub fn filled(&self, depth: u32, known: &Samples) -> Result<Samples, GenError> {
        Ok(self.filled_with_gaps(depth, known)?.0)
    }

    /// Like [`Self::filled`]; also returns the boxes without data whose heights may have been used.
    pub fn filled_with_gaps(&self, depth: u32, known: &Samples) -> Result<(Samples, Vec<HeightAt>), GenError> {
        let mut out = known.clone();
        let (window, width) = (known.window, known.window.width());
        let unknown = known.values.iter().enumerate().filter(|(_, h)| h.is_nan());
        let at = |k: usize| [window.first[0] + (k % width) as i64, window.first[1] + (k / width) as i64];
        let patches: BTreeSet<[i64; 2]> = unknown.map(|(k, _)| at(k).map(|c| c / BOX)).collect();
        let boxes = (self.cells(depth) / BOX) + 1;
        let around = |[x, y]: &[i64; 2]| {
            let columns = (x - 1).max(0)..=(x + 1).min(boxes - 1);
            let rows = (y - 1).max(0)..=(y + 1).min(boxes - 1);
            rows.flat_map(move |y| columns.clone().map(move |x| [x, y])).collect::<Vec<_>>()
        };
        let needed: BTreeSet<[i64; 2]> = patches.iter().flat_map(around).collect();
        let means: Result<HashMap<[i64; 2], Arc<BoxMeans>>, GenError> =
            needed.into_par_iter().map(|at| Ok((at, self.means(depth, at, known)?))).collect();
        let means = means?;
        if patches.is_empty() {
            return Ok((out, Vec::new()));
        }
        let empty = means.iter().filter(|(_, means)| !self.is_aligned && means.is_empty());
        let gaps: Result<Vec<HeightAt>, GenError> =
            empty.map(|(at, _)| Ok(HeightAt { depth, at: *at, height_m: self.gap_height_m(depth, *at)? })).collect();
        // Without wide gaps it is not needed.
        let cells = self.cells(depth);
        let pulled: Result<Vec<_>, GenError> = patches
            .into_par_iter()
            .map(|at| {
                let is_empty = !self.is_aligned && around(&at).iter().any(|at| means[at].is_empty());
                let coarse = if is_empty { Some(self.coarse_filled()?) } else { None };
                let height = |[x, y]: [f64; 2]| coarse.map_or(0.0, |coarse| self.coarse_at(coarse, depth, [x, y]));
                Ok((at, fill::pull(at, cells, |x, y| &*means[&[x, y]], height)))
            })
            .collect();
        for (at, heights) in pulled? {
            let first = at.map(|c| c * BOX);
            let patch = Window { first, last: first.map(|c| (c + BOX - 1).min(cells)) };
            let Some(both) = patch.intersection(&window) else { continue };
            for y in both.first[1]..=both.last[1] {
                for x in both.first[0]..=both.last[0] {
                    if known.at(x, y).is_nan() {
                        let height_m = heights[((y - first[1]) as usize) * patch.width() + (x - first[0]) as usize];
                        out.set(x, y, rounded(height_m, self.step_m));
                    }
                }
            }
        }
        Ok((out, gaps?))
    }

    /// Returns the height in metres that stands for a box without data.
    pub fn gap_height_m(&self, depth: u32, at: [i64; 2]) -> Result<f32, GenError> {
        if self.is_aligned {
            return Ok(0.0);
        }
        let middle = at.map(|c| (c * BOX) as f64 + 0.5 * (BOX - 1) as f64);
        Ok(self.coarse_at(self.coarse_filled()?, depth, middle) as f32)
    }

    /// Returns the averages of a box. Those of its vertices that `known` contains are not sampled again.
    fn means(&self, depth: u32, at: [i64; 2], known: &Samples) -> Result<Arc<BoxMeans>, GenError> {
        let key = (depth, at[0], at[1]);
        let lock = || self.boxes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(means) = lock().get(&key) {
            return Ok(means.clone());
        }
        let first = at.map(|c| c * BOX);
        let inside = Window { first, last: first.map(|c| (c + BOX - 1).min(self.cells(depth))) };
        let samples = match known.window.contains(&inside) {
            true => None,
            false => Some(self.sample_flooded(depth, inside)?),
        };
        let mut vertices = Samples::unknown(Window { first, last: first.map(|c| c + BOX - 1) });
        vertices.copy_from(samples.as_ref().unwrap_or(known));
        let means = Arc::new(BoxMeans::new(&vertices.values));
        let mut boxes = lock();
        if boxes.len() >= MAX_BOXES {
            boxes.clear();
        }
        boxes.insert(key, means.clone());
        Ok(means)
    }

    /// Returns the height of a vertex of the lattice of a depth. Vertices without data that are cut continue their
    /// surroundings on this lattice, and those that are filled continue them on the finest one.
    pub fn vertex(&self, depth: u32, at: [i64; 2]) -> Result<f32, GenError> {
        let known = self.sample_flooded(depth, Window { first: at, last: at })?;
        if !known.has_unknown() {
            return Ok(known.values[0]);
        }
        let (depth, at) = if self.voids == Voids::Fill { (0, at.map(|c| c << depth)) } else { (depth, at) };
        let unknown = Samples::unknown(Window { first: at, last: at });
        Ok(self.filled(depth, &unknown)?.values[0])
    }

    /// Returns the number of cells along a side of the coarse lattice.
    fn coarse_cells(&self) -> i64 {
        self.cells(0).min(COARSE_CELLS)
    }

    /// Samples the coarse lattice, without regard to extrema.
    fn coarse(&self) -> Result<&Vec<f32>, GenError> {
        if let Some(coarse) = self.coarse.get() {
            return Ok(coarse);
        }
        let (cells, stride) = (self.coarse_cells(), self.cells(0) / self.coarse_cells());
        let side = cells as usize + 1;
        let sea = if self.voids == Voids::Sea { 0.0 } else { f32::NAN };
        let mut heights = vec![sea; side * side];
        heights.par_chunks_mut(side).enumerate().try_for_each(|(row, heights)| {
            let latitude = self.latitude(row as i64 * stride);
            heights.iter_mut().enumerate().try_for_each(|(column, h)| {
                let known = self.source.height_m(self.longitude(column as i64 * stride), latitude)?;
                *h = known.filter(|h| h.is_finite()).map_or(sea, |h| h as f32);
                Ok::<_, GenError>(())
            })
        })?;
        // Another thread may have been quicker, with the same heights.
        Ok(self.coarse.get_or_init(|| heights))
    }

    fn coarse_filled(&self) -> Result<&Vec<f32>, GenError> {
        if let Some(filled) = self.coarse_filled.get() {
            return Ok(filled);
        }
        let (mut heights, side) = (self.coarse()?.clone(), self.coarse_cells() as usize + 1);
        fill::fill_whole(&mut heights, side, side);
        Ok(self.coarse_filled.get_or_init(|| heights))
    }

    /// Returns a checksum of the heights that wide gaps continue.
    pub fn gaps_checksum(&self) -> Result<u64, GenError> {
        let bytes: Vec<u8> = self.coarse_filled()?.iter().flat_map(|h| h.to_bits().to_le_bytes()).collect();
        Ok(fnv1a(&bytes))
    }

    fn coarse_at(&self, coarse: &[f32], depth: u32, at: [f64; 2]) -> f64 {
        let (side, scale) = (self.coarse_cells() as usize + 1, self.coarse_cells() as f64 / self.cells(depth) as f64);
        fill::bilinear(coarse, [side; 2], at.map(|c| c * scale))
    }

    /// Returns the lowest and the highest sample of the coarse lattice in metres; 0 without any data.
    pub fn coarse_range_m(&self) -> Result<[f32; 2], GenError> {
        if self.is_aligned {
            return Ok(ALIGNED_RANGE_M);
        }
        let known = self.coarse()?.iter().filter(|h| !h.is_nan());
        let range = known.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], h| [a.min(*h), b.max(*h)]);
        Ok(if range[0] <= range[1] { range } else { [0.0; 2] })
    }
}

/// Rounds heights to steps, and makes NaN of those that are not finite.
#[inline(always)]
fn round(heights: &mut [f32], step_m: f64) {
    for h in heights {
        let scaled = f64::from(*h) / step_m;
        // Adding half away from zero and cutting is what `round` does, without a call for each height.
        let half = (0.5f64 - f64::EPSILON / 4.0).copysign(scaled);
        let rounded = ((scaled + half).trunc() * step_m) as f32;
        *h = if h.is_finite() { rounded } else { f32::NAN };
    }
}

/// Rounds a height to steps.
fn rounded(height_m: f32, step_m: f64) -> f32 {
    ((f64::from(height_m) / step_m).round() * step_m) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Gap;

    impl ElevationSource for Gap {
        fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
            let inside = longitude.hypot(latitude) < 0.3;
            Ok((!inside).then_some(100.0 + longitude))
        }
    }

    fn grid(voids: Voids, levels: u32) -> Grid<'static> {
        let extent = Extent { west: -1.0, south: -1.0, east: 1.0, north: 1.0 };
        Grid::new(&Gap, extent, levels, voids, false)
    }

    fn whole(grid: &Grid<'_>) -> Window {
        Window::around([0; 2], grid.cells(0), 0, grid.cells(0))
    }

    #[test]
    fn gaps_are_filled_from_surroundings() {
        for levels in [1, 4] {
            let grid = grid(Voids::Fill, levels);
            let known = grid.sample_flooded(0, whole(&grid)).unwrap();
            assert!(known.values.iter().filter(|h| h.is_nan()).count() > 100);
            let filled = grid.filled(0, &known).unwrap();
            for h in &filled.values {
                assert!((98.5..=101.5).contains(h), "{h}");
                assert_eq!(f64::from(*h) / QUANTUM_M, (f64::from(*h) / QUANTUM_M).round());
            }
        }
    }

    #[test]
    fn heights_do_not_depend_on_the_window() {
        for (voids, depth) in [(Voids::Fill, 0), (Voids::Cut, 1), (Voids::Sea, 2)] {
            let whole = {
                let grid = grid(voids, 4);
                let window = Window::around([0; 2], grid.cells(depth), 0, grid.cells(depth));
                grid.filled(depth, &grid.sample_flooded(depth, window).unwrap()).unwrap()
            };
            let grid = grid(voids, 4);
            for (first, side) in [([70, 41], 40), ([128, 128], 0), ([1, 90], 37)] {
                let window = Window::around(first, side, 0, grid.cells(depth));
                let part = grid.filled(depth, &grid.sample_flooded(depth, window).unwrap()).unwrap();
                for y in window.first[1]..=window.last[1] {
                    for x in window.first[0]..=window.last[0] {
                        assert_eq!(part.at(x, y), whole.at(x, y), "{x} {y}");
                        if (x + y) % 13 == 0 {
                            assert_eq!(grid.vertex(depth, [x, y]).unwrap(), whole.at(x, y), "{x} {y}");
                        }
                    }
                }
            }
        }
    }
}
