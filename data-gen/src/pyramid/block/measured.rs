//! Measures the tiles of a block: errors, ranges of heights, and the part that has data.

use rayon::prelude::*;

use super::Block;
use super::cell::{Bulge, Cell, CellRow};
use crate::GenError;
use crate::pyramid::grid::QUANTUM_M;
use crate::pyramid::samples::HeightAt;
use crate::pyramid::samples::Window;
use crate::pyramid::tile::{CELLS, Coverage, TileFacts, TileKey};

/// The largest error that is rounding of positions, in metres.
const ROUNDING_M: f64 = 1e-6;

impl Block<'_> {
    /// Returns, for each tile of the finest level, the largest distance between its triangles and the source's samples.
    pub(super) fn finest_errors_m(&self) -> Result<Vec<f64>, GenError> {
        let level = self.layer.finest;
        let rows: Vec<Vec<TileKey>> = {
            let keys: Vec<TileKey> = self.keys_of(level).collect();
            keys.chunks(1 << (level - self.root.level)).map(<[TileKey]>::to_vec).collect()
        };
        let heights = self.heights(level);
        let of_row = |keys: &Vec<TileKey>| {
            let side = CELLS as i64;
            let first = [i64::from(keys[0].x) * side, i64::from(keys[0].y) * side];
            let window = Window { first, last: [first[0] + side * keys.len() as i64, first[1] + side] };
            let mut errors_m = vec![0.0f64; keys.len()];
            // The samples inside of the window: their numbers in a row, their columns of cells from the first one on, and their
            // positions in their cells.
            let mut columns: Vec<(u32, u32, f64)> = Vec::new();
            let cell_of = |c: f64, k: usize| {
                let cell = (c as i64).clamp(window.first[k], window.last[k] - 1);
                (cell, c - cell as f64)
            };
            let has_rows = self.grid.source_rows(&window, 0.0, false, &mut |xs, y, row| {
                if columns.is_empty() {
                    let cells = xs.iter().map(|x| cell_of(*x, 0)).zip(0..);
                    let inside = cells.filter(|((_, u), _)| (0.0..=1.0).contains(u));
                    columns.extend(inside.map(|((i, u), sample)| (sample, (i - first[0]) as u32, u)));
                }
                let (j, v) = cell_of(y, 1);
                if !(0.0..=1.0).contains(&v) {
                    return;
                }
                let bulge = Bulge::of_row(self.grid, j, 1);
                let [south, north] = [j, j + 1].map(|j| heights.row_from(first[0], j));
                let is_whole = self.is_whole();
                for (sample, k, u) in &columns {
                    let (h, k) = (row.heights_m[*sample as usize], *k as usize);
                    if !is_whole {
                        let [lower, upper] = self.triangles_at(level, [first[0] + k as i64, j]);
                        if !(if *u >= v { lower } else { upper }) {
                            continue;
                        }
                    }
                    let corners = [south[k], south[k + 1], north[k], north[k + 1]].map(f64::from);
                    let cell = Cell { first: [first[0] + k as i64, j], stride: 1, corners };
                    let error_m = cell.distance_m(&bulge, [*u, v], f64::from(h));
                    // Comparisons with NaN, of samples without data, are false.
                    let tile = &mut errors_m[k / CELLS];
                    if error_m > *tile && error_m >= ROUNDING_M {
                        *tile = error_m;
                    }
                }
            })?;
            if has_rows {
                return Ok(errors_m);
            }
            self.grid.source_samples(&window, 0.0, &mut |[x, y], sample| {
                let [i, j] = [0, 1].map(|k| ([x, y][k] as i64).clamp(window.first[k], window.last[k] - 1));
                let (u, v) = (x - i as f64, y - j as f64);
                let [lower, upper] = self.triangles_at(level, [i, j]);
                if !(0.0..=1.0).contains(&u) || !(0.0..=1.0).contains(&v) || !(if u >= v { lower } else { upper }) {
                    return;
                }
                let corners = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[di, dj]| f64::from(heights.at(i + di, j + dj)));
                let cell = Cell { first: [i, j], stride: 1, corners };
                let bulge = Bulge::of_row(self.grid, j, 1);
                let error_m = cell.distance_m(&bulge, [u, v], sample.height_m);
                if error_m >= ROUNDING_M {
                    let tile = &mut errors_m[((i - window.first[0]) / side) as usize];
                    *tile = tile.max(error_m);
                }
            })?;
            Ok(errors_m)
        };
        let errors: Result<Vec<Vec<f64>>, GenError> = rows.par_iter().map(of_row).collect();
        Ok(errors?.concat())
    }

    /// Measures the tiles of a block of the finest layer, finest level first.
    pub(super) fn measure(&mut self, finest_errors_m: &[f64]) {
        let mut below: Vec<(f64, TileFacts)> = Vec::new();
        for level in (self.root.level..=self.layer.finest).rev() {
            let keys: Vec<TileKey> = self.keys_of(level).collect();
            let measured: Vec<(f64, TileFacts)> = keys
                .into_par_iter()
                .enumerate()
                .map(|(t, key)| {
                    if level == self.layer.finest {
                        return (finest_errors_m[t], self.measure_finest(key, finest_errors_m[t]));
                    }
                    let children = children_of(t, 1 << (level - self.root.level)).map(|child| below[child]);
                    let finest_m = children.iter().map(|(error_m, _)| *error_m).fold(0.0, f64::max);
                    let error_m = self.measure_tile(key) + finest_m;
                    (finest_m, self.combine(key, error_m, children.map(|(_, facts)| facts)))
                })
                .collect();
            self.facts.insert(0, measured.iter().map(|(_, facts)| *facts).collect());
            below = measured;
        }
    }

    /// Combines the parts that the blocks below measured. `below` has for each of them the facts of its root, the error of its
    /// finest level, and [`Record::above_m`]; row-major from the south-west.
    pub(super) fn measure_from(&mut self, below: &[Option<(TileFacts, f64, Vec<f64>)>]) {
        self.above_m = vec![0.0; self.root.level as usize];
        for (_, finest_m, above_m) in below.iter().flatten() {
            self.finest_error_m = self.finest_error_m.max(*finest_m);
            self.above_m.iter_mut().zip(above_m).for_each(|(a, b)| *a = a.max(*b));
        }
        let side = 1usize << (self.layer.finest + 1 - self.root.level);
        let mut finer: Vec<TileFacts> =
            below.iter().map(|part| part.as_ref().map_or(TileFacts::NONE, |(facts, ..)| *facts)).collect();
        for level in (self.root.level..=self.layer.finest).rev() {
            let tiles = 1usize << (level - self.root.level);
            let per_tile = side / tiles;
            let facts: Vec<TileFacts> = self
                .keys_of(level)
                .enumerate()
                .map(|(t, key)| {
                    let [x, y] = [t % tiles * per_tile, t / tiles * per_tile];
                    let parts = (0..per_tile * per_tile).map(|k| (y + k / per_tile) * side + x + k % per_tile);
                    let (mut error_m, mut finest_m) = (0.0f64, 0.0f64);
                    for (_, finest, above_m) in parts.filter_map(|k| below[k].as_ref()) {
                        error_m = error_m.max(above_m.get(level as usize).copied().unwrap_or(0.0));
                        finest_m = finest_m.max(*finest);
                    }
                    self.combine(key, error_m + finest_m, children_of(t, tiles).map(|child| finer[child]))
                })
                .collect();
            self.facts.insert(0, facts.clone());
            finer = facts;
        }
    }

    /// Returns the facts of a tile with a measured error and the facts of its children.
    fn combine(&self, key: TileKey, error_m: f64, children: [TileFacts; 4]) -> TileFacts {
        let mut facts = TileFacts { coverage: Coverage::of_children(children.map(|c| c.coverage)), ..TileFacts::NONE };
        if facts.coverage == Coverage::None {
            return facts;
        }
        // With an error of 0 a flat parent would never be refined.
        facts.error_m = children.iter().fold(error_m.max(QUANTUM_M), |error_m, child| error_m.max(child.error_m));
        for child in children.iter().filter(|child| child.coverage != Coverage::None) {
            facts.add_heights([child.min_height_m, child.max_height_m]);
        }
        if facts.coverage == Coverage::Part {
            self.add_own_heights(key, &mut facts);
        }
        facts
    }

    /// Adds the heights of a tile's vertices, of which some may have no data.
    fn add_own_heights(&self, key: TileKey, facts: &mut TileFacts) {
        let first = [key.x, key.y].map(|c| i64::from(c) * CELLS as i64);
        let heights = self.heights(key.level);
        for y in first[1]..=first[1] + CELLS as i64 {
            facts.add_row(&heights.row_from(first[0], y)[..=CELLS]);
        }
    }

    fn measure_finest(&self, key: TileKey, error_m: f64) -> TileFacts {
        let (first, side) = ([key.x, key.y].map(|c| i64::from(c) * CELLS as i64), CELLS as i64);
        let mut facts = TileFacts { error_m, coverage: Coverage::Whole, ..TileFacts::NONE };
        if self.triangles.is_some() {
            let known = &self.known[0];
            let has_voids =
                (first[1]..=first[1] + side).any(|y| known.row_from(first[0], y)[..=CELLS].iter().any(|h| h.is_nan()));
            let mut cells = (0..side * side).map(|k| [first[0] + k % side, first[1] + k / side]);
            facts.coverage = match has_voids {
                false => Coverage::Whole,
                true if cells.any(|at| self.triangles_at(key.level, at) != [false; 2]) => Coverage::Part,
                true => return TileFacts::NONE,
            };
        }
        self.add_own_heights(key, &mut facts);
        facts
    }

    /// Returns the largest distance between a tile's triangles and the finest samples.
    fn measure_tile(&self, key: TileKey) -> f64 {
        let stride = 1i64 << key.depth(self.grid.levels);
        let first = [key.x, key.y].map(|c| i64::from(c) * CELLS as i64);
        let (heights, finest) = (self.heights(key.level), self.measured());
        let (mut error_m, mut rises) = (0.0f64, Vec::with_capacity(CELLS));
        for y in first[1]..first[1] + CELLS as i64 {
            let bulge = Bulge::of_row(self.grid, y * stride, stride);
            let corners = [y, y + 1].map(|y| &heights.row_from(first[0], y)[..=CELLS]);
            let is_last = y + 1 == first[1] + CELLS as i64;
            let row = CellRow { corners, first: [first[0] * stride, y * stride], stride, is_last };
            let of_row = pulp::Arch::new().dispatch(
                #[inline(always)]
                || row.error_m(&bulge, finest, &mut rises),
            );
            error_m = error_m.max(of_row);
        }
        error_m
    }

    /// Measures the block's part of every tile above it; by level. Also returns the vertices outside of the block that it asked
    /// for.
    pub(super) fn measure_above(&self) -> Result<(Vec<f64>, Vec<HeightAt>), GenError> {
        let (finest, first, side) = (self.measured(), self.first(0), self.side(0));
        let window = Window { first, last: first.map(|c| c + side) };
        let measured: Result<Vec<(f64, Vec<HeightAt>)>, GenError> = (0..self.root.level)
            .into_par_iter()
            .map(|level| {
                let mut asked: Vec<HeightAt> = Vec::new();
                let depth = self.grid.levels - 1 - level;
                let stride = 1i64 << depth;
                let cells = (side / stride).max(1);
                let mut corner = |at: [i64; 2]| -> Result<f64, GenError> {
                    let fine = at.map(|c| c * stride);
                    let is_inside = (0..2).all(|k| (window.first[k]..=window.last[k]).contains(&fine[k]));
                    let own = if is_inside { finest.at(fine[0], fine[1]) } else { f32::NAN };
                    if !own.is_nan() {
                        return Ok(f64::from(own));
                    }
                    let known = asked.iter().find(|vertex| vertex.at == at).map(|vertex| vertex.height_m);
                    let height_m = known.map_or_else(|| self.grid.vertex(depth, at), Ok)?;
                    if known.is_none() {
                        asked.push(HeightAt { depth, at, height_m });
                    }
                    Ok(f64::from(height_m))
                };
                let mut error_m = 0.0f64;
                for k in 0..cells * cells {
                    let at = [first[0] / stride + k % cells, first[1] / stride + k / cells];
                    let [x, y] = at;
                    let corners = [corner(at)?, corner([x + 1, y])?, corner([x, y + 1])?, corner([x + 1, y + 1])?];
                    let cell = Cell { first: at.map(|c| c * stride), stride, corners };
                    let bulge = Bulge::of_row(self.grid, cell.first[1], stride);
                    if let Some(part) = own_samples(&cell).intersection(&window) {
                        error_m = error_m.max(cell.error_m(&bulge, finest, &part));
                    }
                }
                Ok((error_m, asked))
            })
            .collect();
        let (above_m, vertices): (Vec<f64>, Vec<_>) = measured?.into_iter().unzip();
        Ok((above_m, vertices.concat()))
    }
}

/// Returns the indices of the children of the `t`-th of `tiles * tiles` tiles.
fn children_of(t: usize, tiles: usize) -> [usize; 4] {
    let (x, y) = (t % tiles, t / tiles);
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(cx, cy)| (2 * y + cy) * 2 * tiles + 2 * x + cx)
}

/// Returns the samples of a cell. Those on its eastern and northern edges belong to its neighbours, except at the edges of the
/// tile.
fn own_samples(cell: &Cell) -> Window {
    let end = cell.first.map(|c| {
        let last = c + cell.stride;
        if last % (CELLS as i64 * cell.stride) == 0 { last } else { last - 1 }
    });
    Window { first: cell.first, last: end }
}
