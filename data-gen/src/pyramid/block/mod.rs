//! A block: a subtree of the quadtree in memory, with a margin of samples around it.
//!
//! Blocks of the finest layer sample the grid. They measure their part of every tile above them as well, because only they have
//! the finest samples. Blocks above are made of the records of the blocks below.

mod assembled;
mod cell;
mod measured;

use std::ops::RangeInclusive;

use terrane::math::Ellipsoid;

use self::cell::Bulge;
pub(crate) use self::cell::distance_to_finer_m;
use super::dependencies::Dependencies;
use super::fill::BOX;
use super::grid::Grid;
use super::plan::Layer;
use super::record::{Record, Totals};
use super::samples::{Samples, Window};
use super::surface::Surface;
use super::tile::{CELLS, Coverage, TileFacts, TileKey};
use crate::{Extent, GenError, Voids};

/// The samples around a tile that its ambient shading needs, on the lattice of its vertices.
const AMBIENT_MARGIN: i64 = 17;
/// The lattice that shading of the finest three levels uses.
const FINEST_AMBIENT: u32 = 2;

/// The root of a block below, as its block described it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Below {
    pub root: TileKey,
    /// [`Record::region`].
    pub region: [f64; 6],
    /// [`Record::geometric_error_m`].
    pub geometric_error_m: f64,
}

/// A subtree of tiles.
pub(crate) struct Block<'a> {
    grid: &'a Grid<'a>,
    pub root: TileKey,
    pub layer: Layer,
    /// Heights by depth, from that of the finest tiles on, with the vertices without data.
    known: Vec<Samples>,
    /// The same lattices with voids filled from their surroundings on the lattice, if there are any.
    continued: Vec<Option<Samples>>,
    /// The same lattices with voids filled on the finest one, if there are any and they shall be filled.
    filled: Vec<Option<Samples>>,
    /// Smoothed heights by depth, from the one that texels of the finest tiles need on; empty without colour.
    texels: Vec<Samples>,
    /// By level from the finest one, which triangles of the block's cells have data, row-major: the south-eastern and the
    /// north-western one. `None` if all have.
    triangles: Option<Vec<Vec<[bool; 2]>>>,
    /// By level from the root, row-major from the south-west.
    facts: Vec<Vec<TileFacts>>,
    /// The largest difference of the finest level and the source in the block, in metres.
    finest_error_m: f64,
    above_m: Vec<f64>,
    /// The blocks below with data.
    pub below: Vec<Below>,
    /// Vertices of the finest level without data, and the range of those with data. Zero and none above the finest layer.
    voids: u64,
    range_m: [f32; 2],
    dependencies: Dependencies,
}

impl<'a> Block<'a> {
    /// Samples and measures a block of the finest layer. `paints` is true if colours will be asked for.
    pub fn sample(grid: &'a Grid<'a>, layer: Layer, root: TileKey, paints: bool) -> Result<Self, GenError> {
        let mut block = Self::new(grid, layer, root);
        let first = block.first(0);
        let side = block.side(0);
        let margin = 1i64 << (layer.levels() - 1);
        let window = Window::around(first, side, margin, grid.cells(0));
        let mut known = grid.sample(0, window)?;
        block.count_voids(&known);
        grid.flood(&mut known);
        let own = Window { first, last: first.map(|c| c + side) };
        if grid.voids == Voids::Cut && !known.has_data_in(&own) {
            block.leave_out(known, margin, paints);
            return Ok(block);
        }
        let depths = if paints { layer.levels().max(FINEST_AMBIENT + 1) } else { layer.levels() };
        block.known.push(known);
        for depth in 1..depths {
            let margin = if paints && depth >= FINEST_AMBIENT { AMBIENT_MARGIN } else { 1 };
            let window = Window::around(block.first(depth), block.side(depth), margin, grid.cells(depth));
            let inner = block.known[depth as usize - 1].every_second();
            block.known.push(with_ring(grid, depth, window, &inner)?);
        }
        // One cell for extrema that moved, and some for rounding.
        block.dependencies.reach = margin.max(AMBIENT_MARGIN << (depths - 1)) + 4;
        block.fill_voids(None)?;
        block.smooth(paints, None);
        block.find_triangles();
        let finest_errors_m = block.finest_errors_m()?;
        block.finest_error_m = finest_errors_m.iter().copied().fold(0.0, f64::max);
        block.measure(&finest_errors_m);
        (block.above_m, block.dependencies.vertices) = block.measure_above()?;
        Ok(block)
    }

    fn new(grid: &'a Grid<'a>, layer: Layer, root: TileKey) -> Self {
        Self {
            grid,
            root,
            layer,
            known: Vec::new(),
            continued: Vec::new(),
            filled: Vec::new(),
            texels: Vec::new(),
            triangles: None,
            facts: Vec::new(),
            finest_error_m: 0.0,
            above_m: Vec::new(),
            below: Vec::new(),
            voids: 0,
            range_m: [f32::INFINITY, f32::NEG_INFINITY],
            dependencies: Dependencies::default(),
        }
    }

    /// Returns the depth of the lattice of the block's finest tiles.
    fn finest_depth(&self) -> u32 {
        self.grid.levels - 1 - self.layer.finest
    }

    /// Returns the column and row of the block's corner on the lattice of a depth.
    fn first(&self, depth: u32) -> [i64; 2] {
        [self.root.x, self.root.y].map(|c| i64::from(c) * self.side(depth))
    }

    /// Returns the cells along the block's side on the lattice of a depth.
    fn side(&self, depth: u32) -> i64 {
        ((CELLS as i64) << (self.grid.levels - 1 - self.root.level)) >> depth
    }

    /// Describes a block without data at any vertex, whose voids nobody sees: they are not filled, and nothing is measured.
    fn leave_out(&mut self, known: Samples, margin: i64, paints: bool) {
        let cells = self.side(0) as usize;
        self.dependencies.reach = margin + 4;
        self.above_m = vec![0.0; self.root.level as usize];
        self.triangles = Some(coarser_triangles(vec![[false; 2]; cells * cells], self.layer));
        self.facts = (0..self.layer.levels()).map(|level| vec![TileFacts::NONE; 1 << (2 * level)]).collect();
        if paints {
            self.texels.push(Samples::unknown(Window { first: [0; 2], last: [0; 2] }));
        }
        self.known.push(known);
        for depth in 1..self.layer.levels() as usize {
            self.known.push(self.known[depth - 1].every_second());
        }
        self.continued.resize(self.known.len(), None);
        self.filled.resize(self.known.len(), None);
    }

    fn count_voids(&mut self, known: &Samples) {
        let (first, side, cells) = (self.first(0), self.side(0), self.grid.cells(0));
        // The last column and row belong to the next block, if there is one.
        let last = first.map(|c| if c + side == cells { cells } else { c + side - 1 });
        let mut facts = TileFacts::NONE;
        for y in first[1]..=last[1] {
            let row = &known.row_from(first[0], y)[..(last[0] - first[0] + 1) as usize];
            self.voids += row.iter().filter(|h| h.is_nan()).count() as u64;
            facts.add_heights(row.iter().copied());
        }
        if self.grid.voids == Voids::Sea && self.voids > 0 {
            facts.add_heights([0.0]);
        }
        self.range_m = [facts.min_height_m, facts.max_height_m];
    }

    /// Fills voids on each lattice. `filled` has those of the finest depth, if it was made of records.
    fn fill_voids(&mut self, filled: Option<Samples>) -> Result<(), GenError> {
        let finest = self.finest_depth();
        for (k, known) in self.known.iter().enumerate() {
            let has_unknown = known.has_unknown();
            let depth = finest + k as u32;
            let mut continued = None;
            if has_unknown {
                let (heights, gaps) = self.grid.filled_with_gaps(depth, known)?;
                continued = Some(heights);
                // A height depends on the boxes around its own.
                let (first, side, Window { first: low, last: high }) =
                    (self.first(depth), self.side(depth), known.window);
                let margins = [0, 1].map(|c| (first[c] - low[c]).max(high[c] - first[c] - side));
                let reach = (margins[0].max(margins[1]) + 2 * BOX) << depth;
                self.dependencies.reach = self.dependencies.reach.max(reach + 4);
                self.dependencies.add_gaps(gaps);
            }
            let filled = if self.grid.voids != Voids::Fill {
                None
            } else if k == 0 {
                filled.clone().or_else(|| continued.clone().filter(|_| finest == 0))
            } else {
                self.filled[k - 1].as_ref().map(Samples::every_second)
            };
            self.continued.push(continued);
            self.filled.push(filled);
        }
        Ok(())
    }

    /// Smooths heights for texels, from the finest vertices or from what was recorded.
    fn smooth(&mut self, paints: bool, recorded: Option<Samples>) {
        if !paints {
            return;
        }
        let finest = self.finest_depth();
        let mut depth = finest.saturating_sub(2);
        let mut next = recorded.unwrap_or_else(|| self.known[0].clone());
        // The parent of the block needs the last one.
        let last = (finest + self.layer.levels()).saturating_sub(2);
        loop {
            let halved = (depth < last).then(|| next.halved(self.grid.cells(depth)));
            self.texels.push(next);
            let Some(halved) = halved else { return };
            next = halved;
            depth += 1;
        }
    }

    fn find_triangles(&mut self) {
        let (first, side, known) = (self.first(0), self.side(0), &self.known[0]);
        if self.grid.voids != Voids::Cut || !known.has_unknown() {
            return;
        }
        let mut finest = Vec::with_capacity((side * side) as usize);
        for y in first[1]..first[1] + side {
            let [south, north] = [known.row_from(first[0], y), known.row_from(first[0], y + 1)];
            finest.extend((0..side as usize).map(|k| {
                let has = |h: f32| !h.is_nan();
                let diagonal = has(south[k]) && has(north[k + 1]);
                [diagonal && has(south[k + 1]), diagonal && has(north[k])]
            }));
        }
        self.triangles = Some(coarser_triangles(finest, self.layer));
    }

    /// Returns which triangles of a cell have data. The cell is a column and row on the lattice of a level of the block.
    fn triangles_at(&self, level: u32, at: [i64; 2]) -> [bool; 2] {
        let Some(triangles) = &self.triangles else { return [true; 2] };
        let depth = self.grid.levels - 1 - level;
        let [first, side] = [self.first(depth), [self.side(depth); 2]];
        let [x, y] = [0, 1].map(|k| (at[k] - first[k]).clamp(0, side[k] - 1) as usize);
        triangles[(self.layer.finest - level) as usize][y * side[0] as usize + x]
    }

    /// Returns the heights of the lattice of a level.
    fn heights(&self, level: u32) -> &Samples {
        let k = (self.layer.finest - level) as usize;
        self.filled[k].as_ref().or(self.continued[k].as_ref()).unwrap_or(&self.known[k])
    }

    /// Returns the finest samples that errors are measured against: voids count if they were filled.
    fn measured(&self) -> &Samples {
        self.filled[0].as_ref().unwrap_or(&self.known[0])
    }

    /// Returns the keys of a level of the block, row-major from the south-west.
    fn keys_of(&self, level: u32) -> impl Iterator<Item = TileKey> + use<> {
        let (up, root) = (level - self.root.level, self.root);
        let tiles = 1u32 << up;
        (0..tiles)
            .flat_map(move |y| (0..tiles).map(move |x| TileKey { level, x: (root.x << up) + x, y: (root.y << up) + y }))
    }

    /// Returns the keys of the tiles with data, coarse levels first.
    pub fn keys(&self) -> impl Iterator<Item = TileKey> {
        let all = (self.root.level..=self.layer.finest).flat_map(|level| self.keys_of(level));
        all.filter(|key| self.facts(*key).coverage != Coverage::None)
    }

    /// Returns the error and the height range of a tile of the block.
    pub fn facts(&self, key: TileKey) -> TileFacts {
        let up = key.level - self.root.level;
        let [x, y] = [(key.x, self.root.x), (key.y, self.root.y)].map(|(own, root)| (own - (root << up)) as usize);
        self.facts[up as usize][(y << up) + x]
    }

    /// Returns the number of levels of the set.
    pub fn levels(&self) -> u32 {
        self.grid.levels
    }

    /// Returns the ellipsoid that the set is on.
    pub fn ellipsoid(&self) -> Ellipsoid {
        self.grid.ellipsoid
    }

    /// Returns the step in metres that heights are rounded to.
    pub fn step_m(&self) -> f64 {
        self.grid.step_m()
    }

    /// Returns true if all triangles of the block have data.
    pub fn is_whole(&self) -> bool {
        self.triangles.is_none()
    }

    /// Returns the rectangle of a tile.
    pub fn extent(&self, key: TileKey) -> Extent {
        key.extent(&self.grid.extent)
    }

    /// Returns which triangles of the cell (i, j) of a tile have data: the south-eastern and the north-western one. Above the
    /// finest level, both have data if any triangle of the finest level in the cell has.
    pub fn triangles(&self, key: TileKey, i: usize, j: usize) -> [bool; 2] {
        self.triangles_at(
            key.level,
            [(key.x, i), (key.y, j)].map(|(tile, c)| i64::from(tile) * CELLS as i64 + c as i64),
        )
    }

    /// Returns the height of the vertex (i, j) of a tile, with i counted eastwards and j northwards; -1 and 65 are the vertices
    /// next to the tile. Outside of the set it is the height of the nearest vertex inside.
    pub fn height_m(&self, key: TileKey, i: i64, j: i64) -> f32 {
        let at = |tile: u32, v: i64| i64::from(tile) * CELLS as i64 + v;
        self.heights(key.level).at(at(key.x, i), at(key.y, j))
    }

    /// Adds the heights of a row of a tile's vertices, as [`Self::height_m`] returns them.
    pub fn add_heights(&self, key: TileKey, columns: RangeInclusive<i64>, j: i64, out: &mut Vec<f32>) {
        let at = |tile: u32, v: i64| i64::from(tile) * CELLS as i64 + v;
        let (heights, first, last) = (self.heights(key.level), at(key.x, *columns.start()), at(key.x, *columns.end()));
        let Window { first: low, last: high } = heights.window;
        let inside = heights.row_from(first, at(key.y, j));
        let [before, behind] = [(low[0] - first).max(0), (last - high[0]).max(0)].map(|count| count as usize);
        let count = (last - first + 1) as usize - before - behind;
        out.extend(std::iter::repeat_n(inside[0], before));
        out.extend_from_slice(&inside[..count]);
        out.extend(std::iter::repeat_n(inside[count - 1], behind));
    }

    /// Returns the largest vertical distance between the edges of a tile and those that tiles one or two levels coarser have
    /// there, in metres.
    pub fn edge_step_m(&self, key: TileKey) -> f64 {
        let last = CELLS as i64;
        let stride = 1i64 << key.depth(self.grid.levels);
        let edges: [[[i64; 2]; 2]; 4] = [[[0, 0], [1, 0]], [[0, last], [1, 0]], [[0, 0], [0, 1]], [[last, 0], [0, 1]]];
        let mut step_m = 0.0f64;
        for ([x, y], [dx, dy]) in edges.map(|[start, along]| (start, along)) {
            let mut heights = [0.0; CELLS + 1];
            for (k, height) in (0..).zip(&mut heights) {
                *height = f64::from(self.height_m(key, x + k * dx, y + k * dy));
            }
            let height = |k: i64| heights[k as usize];
            let row = (i64::from(key.y) * last + y) * stride;
            for coarser in [2, 4] {
                let [east, north] = Bulge::of_row(self.grid, row, coarser * stride).at(height(0));
                let bulge = if dx == 1 { east } else { north };
                for k in (0..last).filter(|k| k % coarser != 0) {
                    let (t, start) = ((k % coarser) as f64 / coarser as f64, k - k % coarser);
                    let chord = height(start) + t * (height(start + coarser) - height(start));
                    step_m = step_m.max((chord - bulge * t * (1.0 - t) - height(k)).abs());
                }
            }
        }
        step_m
    }

    /// Returns the heights that the colours of a level of the block are made of.
    pub fn surface(&self, level: u32) -> Surface<'_> {
        let depth = self.grid.levels - 1 - level;
        let texels = depth.saturating_sub(2);
        let smooth = &self.texels[(texels - self.finest_depth().saturating_sub(2)) as usize];
        let ambient = depth.max(FINEST_AMBIENT);
        let k = (ambient - self.finest_depth()) as usize;
        let around = self.continued[k].as_ref().unwrap_or(&self.known[k]);
        Surface::new(self.grid, (texels, smooth), (ambient, around))
    }

    /// Returns the record of a block of the finest layer whose tiles are the same, with the errors of the tiles above as this
    /// block has measured them.
    pub fn measured_again(self, record: Record) -> Record {
        Record { above_m: self.above_m, dependencies: self.dependencies, ..record }
    }

    /// Returns the bytes of the block's samples.
    #[cfg(test)]
    pub fn bytes(&self) -> u64 {
        let some = self.continued.iter().chain(&self.filled).flatten();
        let samples: usize =
            self.known.iter().chain(some).chain(&self.texels).map(|samples| samples.values.len()).sum();
        let triangles: usize = self.triangles.iter().flatten().map(Vec::len).sum();
        (4 * samples + 2 * triangles) as u64
    }

    /// Returns the totals of the block's tiles, whose files have `bytes` bytes.
    pub fn totals(&self, bytes: u64) -> Totals {
        let mut totals = Totals::new(self.grid.levels);
        (totals.tiles, totals.bytes, totals.voids, totals.range_m) =
            (self.keys().count() as u64, bytes, self.voids, self.range_m);
        for key in self.keys() {
            let largest = &mut totals.level_errors_m[key.level as usize];
            *largest = largest.max(self.facts(key).error_m);
        }
        totals
    }

    /// Returns the record of the block. The caller adds what depends on the form of the tiles.
    pub fn record(&self, bytes: u64, region: [f64; 6], geometric_error_m: f64, tree: String) -> Record {
        let depth = self.grid.levels - 1 - self.root.level;
        let part = |samples: &Samples, scale: i64| {
            // The lattice of the parent has half as many cells along the block's side.
            let side = CELLS as i64 / 2 * scale;
            let first = [self.root.x, self.root.y].map(|c| i64::from(c) * side);
            let mut out = Samples::unknown(Window { first, last: first.map(|c| c + side) });
            out.copy_from(samples);
            out
        };
        let k = (depth - self.finest_depth()) as usize;
        let cells = self.triangles.as_ref().and_then(|triangles| {
            let has_data: Vec<bool> = triangles.last()?.iter().map(|cell| *cell != [false; 2]).collect();
            let half = CELLS / 2;
            let any = |c: usize| {
                let [x, y] = [2 * (c % half), 2 * (c / half)];
                [[0, 0], [1, 0], [0, 1], [1, 1]].iter().any(|[dx, dy]| has_data[(y + dy) * CELLS + x + dx])
            };
            Some((0..half * half).map(any).collect())
        });
        Record {
            facts: self.facts(self.root),
            finest_error_m: self.finest_error_m,
            above_m: self.above_m.clone(),
            known: part(&self.known[k].every_second(), 1),
            filled: self.filled[k].as_ref().map(|filled| part(&filled.every_second(), 1)),
            texels: self.texels.last().map(|texels| part(texels, 4)),
            cells,
            totals: self.totals(bytes),
            region,
            geometric_error_m,
            tree,
            dependencies: self.dependencies.clone(),
        }
    }
}

/// Samples the part of a window that `inner` does not have.
fn with_ring(grid: &Grid<'_>, depth: u32, window: Window, inner: &Samples) -> Result<Samples, GenError> {
    let mut out = Samples::unknown(window);
    let Some(core) = window.intersection(&inner.window) else { return grid.sample_flooded(depth, window) };
    let [south, north] = [
        Window { first: window.first, last: [window.last[0], core.first[1] - 1] },
        Window { first: [window.first[0], core.last[1] + 1], last: window.last },
    ];
    let [west, east] = [
        Window { first: [window.first[0], core.first[1]], last: [core.first[0] - 1, core.last[1]] },
        Window { first: [core.last[0] + 1, core.first[1]], last: [window.last[0], core.last[1]] },
    ];
    for part in [south, north, west, east] {
        if (0..2).all(|k| part.first[k] <= part.last[k]) {
            out.copy_from(&grid.sample_flooded(depth, part)?);
        }
    }
    out.copy_from(inner);
    Ok(out)
}

/// Returns the triangles with data of each level of a block, from those of its finest level's cells.
fn coarser_triangles(finest: Vec<[bool; 2]>, layer: Layer) -> Vec<Vec<[bool; 2]>> {
    let mut side = CELLS << (layer.levels() - 1);
    let mut levels = vec![finest];
    for _ in 1..layer.levels() {
        let (finer, half) = (&levels[levels.len() - 1], side / 2);
        let any = |k: usize| {
            let at = 2 * (k / half) * side + 2 * (k % half);
            [[at, at + 1, at + side, at + side + 1].iter().any(|at| finer[*at] != [false; 2]); 2]
        };
        let coarser = (0..half * half).map(any).collect();
        levels.push(coarser);
        side = half;
    }
    levels
}
