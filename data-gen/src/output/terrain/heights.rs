//! The heights of the vertices of tiles in the geographic tiling.
//!
//! The tiling is the southern half of a square of 360 degrees, so that a [`Grid`] over the square has its lattices: level 0 of
//! the tiling is level 1 of the square.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::georeference::ROUNDING;
use crate::output::Inputs;
use crate::pyramid::{BOX, CELLS, Grid, Samples, TileKey, Window};
use crate::{ElevationSource, Extent, GenError, Voids};

/// The square whose southern half is the tiling.
pub(super) const SQUARE: Extent = Extent { west: -PI, south: -FRAC_PI_2, east: PI, north: TAU - FRAC_PI_2 };

/// The heights of all tiles. Threads share it.
pub(super) struct Heights<'a> {
    /// The finest lattice of the tiling. It keeps extrema of the source.
    grid: Grid<'a>,
    /// The coarser lattices.
    coarse: Grid<'a>,
    /// The source's rectangle with about the same finest distance of vertices, for voids that are filled; else `None`. Voids
    /// that shall be cut are filled too, because tiles are whole.
    filled: Option<Grid<'a>>,
    voids: Voids,
    /// The rectangle of the source.
    extent: Extent,
    source: &'a dyn ElevationSource,
    levels: u32,
}

/// The heights of a tile's vertices and of one vertex around them.
pub(super) struct TileHeights {
    samples: Samples,
    pub extent: Extent,
    /// The column and row of the tile's corner on the lattice of its level.
    pub first: [i64; 2],
    /// The number of cells along a side of the square on that lattice.
    pub cells: i64,
    /// The lowest and the highest vertex with data, in metres.
    pub data_m: [f32; 2],
    /// Vertices inside of the source's rectangle without data. Those on the eastern and northern edge belong to neighbours.
    pub voids: u64,
    /// The part of the sources that the heights depend on.
    pub inputs: Inputs,
}

impl<'a> Heights<'a> {
    /// `turned` is the source on the longitudes of the tiling, `is_fine` tells if the finest level is as fine as the source.
    pub fn new(
        voids: Voids,
        turned: &'a dyn ElevationSource,
        source: &'a dyn ElevationSource,
        extent: Extent,
        levels: u32,
        is_fine: bool,
    ) -> Self {
        let grid = Grid::new(turned, SQUARE, levels + 1, Voids::Cut, is_fine);
        let coarse = Grid::new(turned, SQUARE, levels + 1, Voids::Cut, false);
        let side = (extent.east - extent.west).max(extent.north - extent.south);
        // The tiles of the source's own quadtree are at most as large as those of the finest level.
        let own_levels = (side / TAU * f64::from(levels + 1).exp2()).log2().ceil().max(0.0) as u32 + 1;
        let filled = (voids != Voids::Sea).then(|| Grid::new(source, extent, own_levels, Voids::Fill, false));
        Self { grid, coarse, filled, voids, extent, source: turned, levels }
    }

    /// Returns the tiles of a level that are written, in Morton order: those where the source may have data, or all on its
    /// rectangle if voids are given heights. Level 0 is whole.
    pub fn tiles(&self, level: u32) -> Vec<TileKey> {
        let mut found = Vec::new();
        for x in 0..2 {
            self.collect(TileKey { level: 0, x, y: 0 }, level, &mut found);
        }
        found
    }

    /// Returns the tiles of a level at or below a tile that are written, in Morton order.
    pub fn tiles_below(&self, key: TileKey, level: u32) -> Vec<TileKey> {
        let mut found = Vec::new();
        if key.level <= level {
            self.collect(key, level, &mut found);
        }
        found
    }

    /// Returns the number of levels.
    pub fn levels(&self) -> u32 {
        self.levels
    }

    fn collect(&self, key: TileKey, level: u32, found: &mut Vec<TileKey>) {
        if key.level > 0 && !self.is_written(key) {
            return;
        }
        if key.level == level {
            found.push(key);
            return;
        }
        key.children().into_iter().for_each(|child| self.collect(child, level, found));
    }

    fn is_written(&self, key: TileKey) -> bool {
        // A tile that only touches the data has none.
        let Extent { west, south, east, north } = in_square(key).extent(&SQUARE);
        let [dx, dy] = [east - west, north - south].map(|side| 1e-6 * side);
        let inner = Extent { west: west + dx, south: south + dy, east: east - dx, north: north - dy };
        self.overlaps(&inner) && (self.voids != Voids::Cut || self.source.may_have_data_in(&inner))
    }

    /// Returns true if a rectangle of the tiling overlaps the source's.
    fn overlaps(&self, e: &Extent) -> bool {
        let own = self.extent;
        let overlaps = |turn: f64| own.west < e.east + turn && e.west + turn < own.east;
        own.south < e.north && e.south < own.north && (overlaps(0.0) || overlaps(TAU))
    }

    /// Returns the heights of a tile. Vertices without data continue their surroundings inside of the source's rectangle,
    /// unless they shall be sea, and lie at 0 m outside. A formula has its heights outside, too.
    pub fn of(&self, key: TileKey) -> Result<TileHeights, GenError> {
        let depth = self.levels - 1 - key.level;
        let (cells, side) = (self.grid.cells(depth), CELLS as i64);
        let first = [key.x, key.y].map(|c| i64::from(c) * side);
        let window = self.window(key);
        let grid = if depth == 0 { &self.grid } else { &self.coarse };
        let mut samples = grid.sample(depth, window)?;
        let extent = in_square(key).extent(&SQUARE);
        let (data_m, inputs) = (NO_HEIGHTS_M, Inputs::Data);
        let mut tile =
            TileHeights { samples: Samples::unknown(window), extent, first, cells, data_m, voids: 0, inputs };
        let step = TAU / cells as f64;
        let filled = self.fill(&extent, step, &samples)?;
        let is_everywhere = self.source.is_formula();
        for y in window.first[1]..=window.last[1] {
            for x in window.first[0]..=window.last[0] {
                let [longitude, latitude] = [SQUARE.west + step * x as f64, SQUARE.south + step * y as f64];
                // Coarse cells across the border of the data would draw its heights far outside.
                let margin = if depth == 0 { 0.0 } else { step };
                let is_inside = is_everywhere || self.is_inside(longitude, latitude, margin);
                let own = [x - first[0], y - first[1]];
                let height_m = samples.at(x, y);
                if height_m.is_nan() && is_inside && own.iter().all(|c| (0..side).contains(c)) {
                    tile.voids += 1;
                }
                if !is_inside || height_m.is_nan() {
                    tile.inputs = match &filled {
                        Some(filled) if filled.has_gaps => Inputs::Gaps,
                        _ => Inputs::Surroundings,
                    };
                    let filled = filled.as_ref().filter(|_| is_inside);
                    samples.set(x, y, filled.map_or(0.0, |filled| filled.at(longitude, latitude)));
                } else if own.iter().all(|c| (0..=side).contains(c))
                    && (!is_everywhere || self.is_inside(longitude, latitude, margin))
                {
                    tile.data_m = [tile.data_m[0].min(height_m), tile.data_m[1].max(height_m)];
                }
            }
        }
        if is_everywhere {
            self.join_coarser(key, &mut samples)?;
        }
        tile.samples = samples;
        Ok(tile)
    }

    /// Moves the vertices on those edges of a tile beyond which there are only coarser tiles onto the lines that these draw. A source
    /// that ends at its rectangle lies at 0 m there.
    fn join_coarser(&self, key: TileKey, samples: &mut Samples) -> Result<(), GenError> {
        let (columns, side) = (2i64 << key.level, CELLS as i64);
        let [left, bottom] = [key.x, key.y].map(|c| i64::from(c) * side);
        for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            let [x, y] = [(i64::from(key.x) + dx).rem_euclid(columns), i64::from(key.y) + dy];
            if !(0..columns / 2).contains(&y) {
                continue;
            }
            let is_there = |up: u32| {
                let beyond = TileKey { level: key.level - up, x: (x >> up) as u32, y: (y >> up) as u32 };
                beyond.level == 0 || self.is_written(beyond)
            };
            let up = (0..=key.level).find(|up| is_there(*up)).unwrap_or(key.level).min(CELLS.ilog2());
            if up == 0 {
                continue;
            }
            // Coarse levels have no rivers: their heights are others at the common vertices, too.
            let first = [left >> up, bottom >> up];
            let window = Window { first, last: first.map(|c| c + (side >> up)) };
            let coarser = self.coarse.sample(self.levels - 1 - key.level + up, window)?;
            let stride = 1i64 << up;
            let at = |k: i64| match (dx, dy) {
                (0, _) => [left + k, bottom + if dy < 0 { 0 } else { side }],
                _ => [left + if dx < 0 { 0 } else { side }, bottom + k],
            };
            for k in 0..=side {
                let start = (k - k % stride).min(side - stride);
                let [low, high] = [start, start + stride].map(|k| {
                    let [x, y] = at(k);
                    coarser.at(x >> up, y >> up)
                });
                let (share, [x, y]) = ((k - start) as f32 / stride as f32, at(k));
                samples.set(x, y, low * (1.0 - share) + high * share);
            }
        }
        Ok(())
    }

    /// Returns true if the source knows where water is.
    pub fn has_water(&self) -> Result<bool, GenError> {
        self.source.water_depths_m(&[], &[], &mut [])
    }

    /// Returns the depths of open water at the vertices of a tile in metres, below 0 on land, southern row first. `None` if the
    /// source does not know them.
    pub fn water_depths_m(&self, key: TileKey) -> Result<Option<Vec<f32>>, GenError> {
        let step = TAU / self.grid.cells(self.levels - 1 - key.level) as f64;
        let first = [key.x, key.y].map(|c| i64::from(c) * CELLS as i64);
        let along = |from: f64, first: i64| (0..=CELLS as i64).map(|k| from + step * (first + k) as f64).collect();
        let (longitudes, latitudes): (Vec<f64>, Vec<f64>) =
            (along(SQUARE.west, first[0]), along(SQUARE.south, first[1]));
        let mut depths_m = vec![0.0; longitudes.len() * latitudes.len()];
        let is_known = self.source.water_depths_m(&longitudes, &latitudes, &mut depths_m)?;
        Ok(is_known.then_some(depths_m))
    }

    /// Returns the vertices of a tile and one around them, on the lattice of its level.
    fn window(&self, key: TileKey) -> Window {
        let cells = self.grid.cells(self.levels - 1 - key.level);
        let first = [key.x, key.y].map(|c| i64::from(c) * CELLS as i64);
        let mut window = Window::around(first, CELLS as i64, 1, cells);
        // Beyond the pole there is no earth.
        window.last[1] = window.last[1].min(cells / 2);
        window
    }

    /// Returns the rectangle of what the heights of a tile with some inputs depend on, which may have longitudes beyond 180
    /// degrees. `None` if the heights depend on data alone, but vertices lie outside of the source's rectangle.
    pub fn near(&self, key: TileKey, inputs: Inputs) -> Option<Extent> {
        let depth = self.levels - 1 - key.level;
        let (window, step) = (self.window(key), TAU / self.grid.cells(depth) as f64);
        let at = |[x, y]: [i64; 2]| [SQUARE.west + step * x as f64, SQUARE.south + step * y as f64];
        let ([west, south], [east, north]) = (at(window.first), at(window.last));
        let margin = if depth == 0 { 0.0 } else { step };
        let corners = [[west, south], [east, south], [west, north], [east, north]];
        let is_inside = || corners.iter().all(|[longitude, latitude]| self.is_inside(*longitude, *latitude, margin));
        if inputs == Inputs::Data && !is_inside() {
            return None;
        }
        // Extrema move by less than a cell.
        let mut reach = [step; 2];
        if let Some(grid) = self.filled.as_ref().filter(|_| inputs != Inputs::Data) {
            // A filled height depends on the boxes around its own.
            let (fine, depth) = self.filled_depth(grid, step);
            let boxes = f64::from(depth).exp2() * (2 * BOX + 4) as f64;
            reach = [reach[0] + fine[0] * boxes, reach[1] + fine[1] * boxes];
        }
        let [dx, dy] = reach;
        Some(Extent { west: west - dx, south: south - dy, east: east + dx, north: north + dy })
    }

    /// Returns a checksum of the heights that wide gaps continue.
    pub fn gaps_checksum(&self) -> Result<Option<u64>, GenError> {
        self.filled.as_ref().map(Grid::gaps_checksum).transpose()
    }

    /// Returns the steps of the source's own lattice in radians, and the depth of the one of it that fills tiles with a step.
    fn filled_depth(&self, grid: &Grid<'_>, step: f64) -> ([f64; 2], u32) {
        let cells = grid.cells(0) as f64;
        let [dx, dy] =
            [self.extent.east - self.extent.west, self.extent.north - self.extent.south].map(|side| side / cells);
        ([dx, dy], (step / dx.max(dy)).log2().floor().clamp(0.0, f64::from(grid.levels + 5)) as u32)
    }

    /// Returns true if a position lies in the source's rectangle, at least `margin` radians from its borders.
    fn is_inside(&self, longitude: f64, latitude: f64, margin: f64) -> bool {
        let Extent { west, south, east, north } = self.extent;
        let rounding = 1e-3 * TAU / self.grid.cells(0) as f64;
        let is_around = east - west >= TAU - ROUNDING;
        let longitude = if longitude < west - rounding { longitude + TAU } else { longitude };
        // Nothing lies beyond a pole.
        let from = |edge: f64| if edge.abs() >= FRAC_PI_2 - ROUNDING { 0.0 } else { margin } - rounding;
        let is_high = (south + from(south)..=north - from(north)).contains(&latitude);
        let margin = margin - rounding;
        is_high && (is_around || (west + margin..=east - margin).contains(&longitude))
    }

    /// Returns the source's own lattice around a tile with filled voids, if the tile has some and they shall be filled.
    fn fill(&self, tile: &Extent, step: f64, samples: &Samples) -> Result<Option<Filled<'_, 'a>>, GenError> {
        let Some(grid) = self.filled.as_ref().filter(|_| samples.has_unknown()) else { return Ok(None) };
        let (_, depth) = self.filled_depth(grid, step);
        let turn = if tile.east <= self.extent.west { TAU } else { 0.0 };
        let corners = [[tile.west, tile.south], [tile.east, tile.north]].map(|[longitude, latitude]| {
            grid.position(longitude + turn, latitude).map(|c| c / f64::from(depth).exp2())
        });
        let last = grid.cells(depth);
        let window = Window {
            first: corners[0].map(|c| (c.floor() as i64 - 2).clamp(0, last)),
            last: corners[1].map(|c| (c.ceil() as i64 + 2).clamp(0, last)),
        };
        let known = grid.sample_flooded(depth, window)?;
        let (samples, gaps) = match known.has_unknown() {
            true => grid.filled_with_gaps(depth, &known)?,
            false => (known, Vec::new()),
        };
        Ok(Some(Filled { grid, depth, samples, west: self.extent.west, has_gaps: !gaps.is_empty() }))
    }
}

/// The heights before any is known.
pub(super) const NO_HEIGHTS_M: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

/// A part of the source's own lattice without voids.
struct Filled<'g, 'a> {
    grid: &'g Grid<'a>,
    depth: u32,
    samples: Samples,
    west: f64,
    /// True if boxes around have no data.
    has_gaps: bool,
}

impl Filled<'_, '_> {
    /// Returns the height at a position on the tiling in metres.
    fn at(&self, longitude: f64, latitude: f64) -> f32 {
        let longitude = if longitude < self.west - ROUNDING { longitude + TAU } else { longitude };
        let scale = f64::from(self.depth).exp2();
        let [x, y] = self.grid.position(longitude, latitude).map(|c| c / scale);
        self.samples.bilinear(x, y)
    }
}

/// Returns the key of a tile of the tiling in the square.
fn in_square(key: TileKey) -> TileKey {
    TileKey { level: key.level + 1, ..key }
}

impl TileHeights {
    /// Returns the height of the vertex (i, j), counted eastwards and northwards. Those around the tile are there too, except
    /// beyond the pole and the date line.
    pub fn height_m(&self, i: i64, j: i64) -> f32 {
        self.samples.at(self.first[0] + i, self.first[1] + j)
    }

    /// Returns the vertices before and after one along an axis, as far as there are some.
    pub fn neighbors(&self, c: i64, axis: usize) -> [i64; 2] {
        let Window { first, last } = self.samples.window;
        [(c - 1).max(first[axis] - self.first[axis]), (c + 1).min(last[axis] - self.first[axis])]
    }

    /// Returns the lowest and the highest vertex of the tile in metres.
    pub fn range_m(&self) -> [f32; 2] {
        let side = CELLS as i64;
        let vertices = (0..=side).flat_map(|j| (0..=side).map(move |i| [i, j]));
        vertices.map(|[i, j]| self.height_m(i, j)).fold(NO_HEIGHTS_M, |[low, high], h| [low.min(h), high.max(h)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rectangle with a hole around its middle.
    struct Plateau(Extent);

    impl ElevationSource for Plateau {
        fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
            let e = self.0;
            let is_inside = (e.west..=e.east).contains(&longitude) && (e.south..=e.north).contains(&latitude);
            let [x, y] = [longitude - 0.5 * (e.west + e.east), latitude - 0.5 * (e.south + e.north)];
            Ok((is_inside && x.hypot(y) > 0.02).then_some(500.0 + 100.0 * x))
        }
    }

    const EXTENT: Extent = Extent { west: 0.11, south: 0.71, east: 0.32, north: 0.9 };

    fn all(voids: Voids, level: u32, levels: u32) -> Vec<TileHeights> {
        let source = Plateau(EXTENT);
        let heights = Heights::new(voids, &source, &source, EXTENT, levels, false);
        heights.tiles(level).into_iter().map(|key| heights.of(key).unwrap()).collect()
    }

    #[test]
    fn vertices_outside_of_the_data_are_at_the_sea() {
        let finest = all(Voids::Sea, 5, 6);
        assert!(finest.len() > 4);
        assert!(finest.iter().any(|tile| tile.voids > 0));
        let ranges: Vec<[f32; 2]> = finest.iter().map(|tile| tile.range_m()).collect();
        assert!(ranges.iter().all(|[low, high]| *low == 0.0 && (480.0..520.0).contains(high)), "{ranges:?}");
        // Coarse cells do not carry heights out of the source's rectangle.
        let mut found = 0;
        for tile in all(Voids::Sea, 0, 6) {
            let step = (tile.extent.east - tile.extent.west) / 64.0;
            for (i, j) in (0..65 * 65).map(|k| (k % 65, k / 65)).filter(|(i, j)| tile.height_m(*i, *j) != 0.0) {
                let longitude = tile.extent.west + step * i as f64;
                let latitude = tile.extent.south + step * j as f64;
                assert!(longitude - step >= EXTENT.west - 1e-9 && longitude + step <= EXTENT.east + 1e-9);
                assert!(latitude - step >= EXTENT.south - 1e-9 && latitude + step <= EXTENT.north + 1e-9);
                found += 1;
            }
        }
        assert!(found > 0);
    }

    #[test]
    fn voids_are_filled_inside_of_the_rectangle() {
        for tile in [all(Voids::Fill, 5, 6), all(Voids::Cut, 5, 6)].into_iter().flatten() {
            for (i, j) in (0..65 * 65).map(|k| (k % 65, k / 65)) {
                let [longitude, latitude] = [
                    tile.extent.west + (tile.extent.east - tile.extent.west) * i as f64 / 64.0,
                    tile.extent.south + (tile.extent.north - tile.extent.south) * j as f64 / 64.0,
                ];
                let is_inside = (0.1101..0.3199).contains(&longitude) && (0.7101..0.8999).contains(&latitude);
                let is_outside = !(0.1099..0.3201).contains(&longitude) || !(0.7099..0.9001).contains(&latitude);
                let h = tile.height_m(i, j);
                assert!(!is_inside || (480.0..520.0).contains(&h), "{longitude} {latitude}: {h}");
                assert!(!is_outside || h == 0.0, "{longitude} {latitude}: {h}");
            }
        }
    }
}
