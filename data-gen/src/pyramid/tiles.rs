//! The quadtree over a grid. Level L takes every `2^(levels-1-L)`-th sample, so that coarse samples equal fine samples
//! bit for bit.
//!
//! The error of a tile is measured. It is the largest height difference between its triangles (diagonal south-west to
//! north-east) and all samples of the finest level inside it. The difference of the finest level and the source is added.
//! The differences include the bulge of the earth above flat triangles, which is metres where samples lie kilometres apart.

use rayon::prelude::*;
use terrane::math::WGS84;

use super::grid::{Extent, Grid, QUANTUM_M};
use crate::{ElevationSource, GenError};

/// The number of cells along a tile's side.
pub const CELLS: usize = 64;

/// The position of a tile in the quadtree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileKey {
    /// The level; the root has level 0.
    pub level: u32,
    /// The column, counted from the west.
    pub x: u32,
    /// The row, counted from the south.
    pub y: u32,
}

/// The measured error and height range of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileFacts {
    /// The measured error in metres, at least that of each child.
    pub error_m: f64,
    /// The lowest height of the finest samples inside the tile.
    pub min_height_m: f32,
    /// The highest height of the finest samples inside the tile.
    pub max_height_m: f32,
    /// The part of the tile that has data.
    pub coverage: Coverage,
}

/// The part of a tile that has data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// No triangle has data.
    None,
    /// Some triangles have data.
    Part,
    /// All samples have data.
    Whole,
}

/// The largest error that is rounding of positions, in metres.
const ROUNDING_M: f64 = 1e-6;

/// A grid as a quadtree of tiles.
pub struct Pyramid {
    /// The finest level's samples.
    pub grid: Grid,
    /// The number of levels.
    pub levels: u32,
    /// Facts by level, row-major from the south-west.
    facts: Vec<Vec<TileFacts>>,
}

impl Pyramid {
    /// Measures every tile on all threads against the samples of `source` and the grid. Panics unless the grid's side is
    /// `64 * 2^(levels-1) + 1`.
    pub fn new(grid: Grid, levels: u32, source: &dyn ElevationSource) -> Result<Self, GenError> {
        assert_eq!(grid.side, (CELLS << (levels - 1)) + 1, "the grid was sampled for this pyramid");
        let mut facts: Vec<Vec<TileFacts>> = Vec::new();
        // The error of the finest level below each tile of the current level.
        let mut finest_errors_m = finest_errors_m(&grid, 1 << (levels - 1), source)?;
        for level in (0..levels).rev() {
            let tiles = 1usize << level;
            let finer = facts.last();
            let children = |t: usize| {
                let (x, y) = (t % tiles, t / tiles);
                [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(cx, cy)| (2 * y + cy) * 2 * tiles + 2 * x + cx)
            };
            if finer.is_some() {
                let below = |t: usize| children(t).map(|child| finest_errors_m[child]).into_iter().fold(0.0, f64::max);
                finest_errors_m = (0..tiles * tiles).map(below).collect();
            }
            let measured: Vec<TileFacts> = (0..tiles * tiles)
                .into_par_iter()
                .map(|t| {
                    let mut f = measure(&grid, levels, level, t % tiles, t / tiles);
                    f.error_m += finest_errors_m[t];
                    if let Some(finer) = finer {
                        let children = children(t).map(|child| finer[child]);
                        f.error_m = children.iter().fold(f.error_m, |error_m, child| error_m.max(child.error_m));
                        // With an error of 0 a flat parent would never be refined.
                        f.error_m = f.error_m.max(QUANTUM_M);
                        f.coverage = match children.map(|child| child.coverage) {
                            [Coverage::None, Coverage::None, Coverage::None, Coverage::None] => Coverage::None,
                            [Coverage::Whole, Coverage::Whole, Coverage::Whole, Coverage::Whole] => Coverage::Whole,
                            _ => Coverage::Part,
                        };
                    }
                    f
                })
                .collect();
            facts.push(measured);
        }
        facts.reverse();
        Ok(Self { grid, levels, facts })
    }

    /// Returns the distance between neighbouring vertices of a level, in samples of the finest level.
    pub fn stride(&self, level: u32) -> usize {
        1 << (self.levels - 1 - level)
    }

    /// Returns the error and the height range of a tile.
    pub fn facts(&self, key: TileKey) -> TileFacts {
        self.facts[key.level as usize][((key.y << key.level) + key.x) as usize]
    }

    /// Returns the keys of all tiles with data, coarse levels first.
    pub fn keys(&self) -> impl Iterator<Item = TileKey> {
        let all = (0..self.levels).flat_map(|level| {
            (0..1u32 << level).flat_map(move |y| (0..1 << level).map(move |x| TileKey { level, x, y }))
        });
        all.filter(|key| self.facts(*key).coverage != Coverage::None)
    }

    /// Returns which triangles of the cell (i, j) of a tile have data: the south-eastern and the north-western one. Above the
    /// finest level, both have data if any triangle of the finest level in the cell has.
    pub fn triangles(&self, key: TileKey, i: usize, j: usize) -> [bool; 2] {
        if self.grid.is_whole() {
            return [true; 2];
        }
        let stride = self.stride(key.level);
        let [x, y] = [(key.x, i), (key.y, j)].map(|(tile, cell)| (tile as usize * CELLS + cell) * stride);
        if stride == 1 {
            return self.grid.triangles(x, y);
        }
        let mut cells = (y..y + stride).flat_map(|row| (x..x + stride).map(move |column| (column, row)));
        [cells.any(|(column, row)| self.grid.triangles(column, row) != [false; 2]); 2]
    }

    /// Returns the rectangle of a tile.
    pub fn extent(&self, key: TileKey) -> Extent {
        let e = self.grid.extent;
        let n = f64::from(1u32 << key.level);
        let lon = |t: f64| e.west + (e.east - e.west) * (t / n);
        let lat = |t: f64| e.south + (e.north - e.south) * (t / n);
        let (x, y) = (f64::from(key.x), f64::from(key.y));
        Extent { west: lon(x), south: lat(y), east: lon(x + 1.0), north: lat(y + 1.0) }
    }

    /// Returns the height of the vertex (i, j) of a tile, with i counted eastwards and j northwards. Outside of the set it
    /// is the height of the nearest vertex inside.
    pub fn height_m(&self, key: TileKey, i: i64, j: i64) -> f32 {
        let stride = self.stride(key.level) as i64;
        let last = self.grid.side as i64 - 1;
        let at = |tile: u32, v: i64| ((i64::from(tile) * CELLS as i64 + v) * stride).clamp(0, last) as usize;
        self.grid.heights[at(key.y, j) * self.grid.side + at(key.x, i)]
    }

    /// Returns an error for each level in metres, root first: the largest of its tiles, at least 1.5 times that of the
    /// next finer level. The factor keeps the ranges in which neighbouring levels morph apart.
    pub fn level_errors_m(&self) -> Vec<f64> {
        let mut errors = vec![0.0f64; self.levels as usize];
        let last = self.levels as usize - 1;
        let largest = |level: usize| self.facts[level].iter().map(|f| f.error_m).fold(0.0, f64::max);
        errors[last] = largest(last);
        for level in (0..last).rev() {
            let largest = largest(level);
            errors[level] = largest.max(1.5 * errors[level + 1]).max(QUANTUM_M);
        }
        errors
    }
}

/// Returns for each tile of the finest level, row-major from the south-west, the largest height difference in metres between
/// its triangles and the samples of a source inside it.
fn finest_errors_m(grid: &Grid, tiles: usize, source: &dyn ElevationSource) -> Result<Vec<f64>, GenError> {
    let largest = |mut a: Vec<f64>, b: Vec<f64>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a = a.max(b));
        a
    };
    let none = || vec![0.0f64; tiles * tiles];
    let measured = grid.bands().into_par_iter().map(|band| {
        let mut errors = none();
        source.samples_in(&band, &mut |sample| {
            let [x, y] = grid.position(sample.longitude, sample.latitude);
            let [i, j] = [x, y].map(|c| (c as usize).min(grid.side - 2));
            let (u, v) = (x - i as f64, y - j as f64);
            let [lower, upper] = grid.triangles(i, j);
            if !(if u >= v { lower } else { upper }) {
                return;
            }
            let at = |di: usize, dj: usize| f64::from(grid.heights[(j + dj) * grid.side + i + di]);
            let surface = on_triangles([at(0, 0), at(1, 0), at(0, 1), at(1, 1)], u, v);
            let [east, north] = bulges_m(grid, j, 1, sample.height_m);
            let bulge = east * u * (1.0 - u) + north * v * (1.0 - v);
            let error = (surface - bulge - sample.height_m).abs();
            let tile = &mut errors[j / CELLS * tiles + i / CELLS];
            *tile = tile.max(if error < ROUNDING_M { 0.0 } else { error });
        })?;
        Ok(errors)
    });
    measured.try_reduce(none, |a, b| Ok(largest(a, b)))
}

/// Returns the height at a position in a cell, 0..1 from west and from south, on its two triangles. The corners are in the
/// order south-west, south-east, north-west, north-east.
fn on_triangles([sw, se, nw, ne]: [f64; 4], u: f64, v: f64) -> f64 {
    if u >= v { sw + u * (se - sw) + v * (ne - se) } else { sw + v * (nw - sw) + u * (ne - nw) }
}

/// Measures a tile without regard to its children and to the source.
fn measure(grid: &Grid, levels: u32, level: u32, x: usize, y: usize) -> TileFacts {
    let stride = 1usize << (levels - 1 - level);
    let (x0, y0) = (x * CELLS * stride, y * CELLS * stride);
    let at = |i: usize, j: usize| grid.heights[j * grid.side + i];
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for j in y0..=y0 + CELLS * stride {
        for h in &grid.heights[j * grid.side + x0..=j * grid.side + x0 + CELLS * stride] {
            low = low.min(*h);
            high = high.max(*h);
        }
    }
    let mut error = 0.0f64;
    if stride > 1 {
        let step = 1.0 / stride as f64;
        for cj in 0..CELLS {
            let [bulge_east, bulge_north] = bulges_m(grid, y0 + cj * stride, stride, high.into());
            for ci in 0..CELLS {
                let (i, j) = (x0 + ci * stride, y0 + cj * stride);
                let corner = |di: usize, dj: usize| f64::from(at(i + di * stride, j + dj * stride));
                let (sw, se, nw, ne) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
                for b in 0..=stride {
                    for a in 0..=stride {
                        let (u, v) = (a as f64 * step, b as f64 * step);
                        let surface = on_triangles([sw, se, nw, ne], u, v);
                        let bulge = bulge_east * u * (1.0 - u) + bulge_north * v * (1.0 - v);
                        error = error.max((surface - bulge - f64::from(at(i + a, j + b))).abs());
                    }
                }
            }
        }
    }
    let mut coverage = Coverage::Whole;
    if !grid.is_whole() && stride == 1 {
        let inside = || (y0..=y0 + CELLS).flat_map(|j| (x0..=x0 + CELLS).map(move |i| (i, j)));
        let mut cells = inside().filter(|(i, j)| *i < x0 + CELLS && *j < y0 + CELLS);
        coverage = match () {
            () if inside().all(|(i, j)| !grid.is_void(i, j)) => Coverage::Whole,
            () if cells.any(|(i, j)| grid.triangles(i, j) != [false; 2]) => Coverage::Part,
            () => Coverage::None,
        };
    }
    TileFacts { error_m: error, min_height_m: low, max_height_m: high, coverage }
}

/// Returns how far the earth rises above chords through cells of `stride` samples from row `j` on. The two values are
/// the factors of t (1 - t) from west to east and from south to north. Inside a triangle both terms add up; at the
/// middle of its longest side the sum is the length squared divided by eight radii.
fn bulges_m(grid: &Grid, j: usize, stride: usize, height_m: f64) -> [f64; 2] {
    let (e, cells) = (grid.extent, (grid.side - 1) as f64);
    let (d_lon, d_lat) = ((e.east - e.west) / cells * stride as f64, (e.north - e.south) / cells * stride as f64);
    let south = e.south + (e.north - e.south) * (j as f64 / cells);
    // The latitude at which the cells are widest.
    let latitude = 0f64.clamp(south.min(south + d_lat), south.max(south + d_lat));
    let east_radius = WGS84.prime_vertical_radius_m(latitude);
    let flatter = 1.0 - WGS84.eccentricity_squared() * latitude.sin().powi(2);
    let north_radius = east_radius * (1.0 - WGS84.eccentricity_squared()) / flatter;
    let east = (east_radius + height_m) * (latitude.cos() * d_lon).powi(2);
    let north = (north_radius + height_m) * d_lat.powi(2);
    [0.5 * east, 0.5 * north]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Procedural;
    use terrane::math::Geodetic;

    fn pyramid() -> Pyramid {
        let source = Procedural { seed: 7, cos_latitude: 0.68 };
        let extent = Extent { west: 0.139, south: 0.82, east: 0.141, north: 0.8215 };
        Pyramid::new(Grid::sample(&source as &dyn ElevationSource, extent, 257).unwrap(), 3, &source).unwrap()
    }

    #[test]
    fn shared_vertices_have_equal_bits() {
        let p = pyramid();
        for key in p.keys() {
            for t in 0..=64 {
                if key.x + 1 < 1 << key.level {
                    let east = TileKey { x: key.x + 1, ..key };
                    assert_eq!(p.height_m(key, 64, t).to_bits(), p.height_m(east, 0, t).to_bits());
                }
                if key.level + 1 < p.levels {
                    let child = TileKey { level: key.level + 1, x: 2 * key.x + 1, y: 2 * key.y };
                    if t % 2 == 0 && t <= 64 {
                        let (coarse, fine) = (p.height_m(key, 32 + t / 2, t / 2), p.height_m(child, t, t));
                        assert_eq!(coarse.to_bits(), fine.to_bits());
                    }
                }
            }
        }
    }

    /// Returns the largest distance between a tile's triangles, flat in space, and the finest samples, in metres.
    fn farthest_m(p: &Pyramid, key: TileKey) -> f64 {
        let s = p.stride(key.level);
        let (first, e) = ([key.x, key.y].map(|t| t as usize * CELLS * s), p.grid.extent);
        let cells = (p.grid.side - 1) as f64;
        let at = |i: usize, j: usize| Geodetic {
            longitude: e.west + (e.east - e.west) * (first[0] + i) as f64 / cells,
            latitude: e.south + (e.north - e.south) * (first[1] + j) as f64 / cells,
            height_m: p.grid.heights[(first[1] + j) * p.grid.side + first[0] + i].into(),
        };
        let mut worst = 0.0f64;
        for fj in 0..=CELLS * s {
            for fi in 0..=CELLS * s {
                let (i, j) = ((fi / s).min(CELLS - 1) * s, (fj / s).min(CELLS - 1) * s);
                let other = if fi - i >= fj - j { at(i + s, j) } else { at(i, j + s) };
                let [a, b, c] = [at(i, j), other, at(i + s, j + s)].map(|g| WGS84.ecef(&g));
                let (sample, normal) = (at(fi, fj), (b - a).cross(c - a));
                let up = WGS84.ecef_from_enu(&sample).matrix3.z_axis;
                worst = worst.max((normal.dot(a - WGS84.ecef(&sample)) / normal.dot(up)).abs());
            }
        }
        worst
    }

    #[test]
    fn errors_equal_brute_force_and_are_at_least_those_of_children() {
        let p = pyramid();
        for key in p.keys().filter(|k| k.level + 1 < p.levels) {
            let mut expected = farthest_m(&p, key);
            for (cx, cy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let child = TileKey { level: key.level + 1, x: 2 * key.x + cx, y: 2 * key.y + cy };
                assert!(p.facts(key).error_m >= p.facts(child).error_m);
                expected = expected.max(p.facts(child).error_m);
            }
            // Flat triangles in space are not exactly triangles in longitude and latitude.
            assert!((p.facts(key).error_m - expected).abs() < 0.005, "{key:?} {} {expected}", p.facts(key).error_m);
        }
        let errors = p.level_errors_m();
        assert!(errors.windows(2).all(|w| w[0] > w[1] && w[0] >= 1.5 * w[1]), "{errors:?}");
    }

    struct Flat;

    impl ElevationSource for Flat {
        fn height_m(&self, _: f64, _: f64) -> Result<Option<f64>, GenError> {
            Ok(Some(1000.0))
        }
    }

    /// Regression: flat land of several degrees had no error, and moved by metres between levels.
    #[test]
    fn errors_include_the_bulge_of_the_earth() {
        for (south, wide) in [(-2.0f64, 5.0f64), (44.0, 6.0), (70.0, 10.0)] {
            let [west, south, east, north] = [10.0, south, 10.0 + wide, south + 4.0].map(f64::to_radians);
            let grid = Grid::sample(&Flat, Extent { west, south, east, north }, 257).unwrap();
            let p = Pyramid::new(grid, 3, &Flat).unwrap();
            for key in p.keys().filter(|k| k.level + 1 < p.levels) {
                let (error, brute) = (p.facts(key).error_m, farthest_m(&p, key));
                assert!(error > 0.99 * brute && error < 1.02 * brute + 0.01, "{key:?} {error} {brute}");
            }
            let latitude = if south < 0.0 { 0.0 } else { south };
            let diagonal = ((east - west) / 64.0 * latitude.cos()).hypot((north - south) / 64.0) * 6_371_000.0;
            let error = p.facts(TileKey { level: 0, x: 0, y: 0 }).error_m;
            assert!((error / (diagonal * diagonal / (8.0 * 6_371_000.0)) - 1.0).abs() < 0.02, "{error}");
        }
    }
}
