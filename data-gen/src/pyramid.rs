//! The quadtree over a grid: level L is every `2^(levels-1-L)`-th sample, so coarse samples are fine samples, bit for bit.
//!
//! The error of a tile is measured: the largest height difference between its triangles (diagonal south-west to
//! north-east) and every sample of the finest level inside it.

use rayon::prelude::*;

use crate::grid::{Extent, Grid};

/// Cells along a tile's side.
pub const CELLS: usize = 64;

/// A tile: level 0 is the root; x counts east, y north.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileKey {
    /// Level, root 0.
    pub level: u32,
    /// Column from the west.
    pub x: u32,
    /// Row from the south.
    pub y: u32,
}

/// What is known of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileFacts {
    /// Measured error in metres, never below a child's.
    pub error_m: f64,
    /// Lowest height of the finest samples inside.
    pub min_height_m: f32,
    /// Highest height of the finest samples inside.
    pub max_height_m: f32,
}

/// A grid as a quadtree of tiles.
pub struct Pyramid {
    /// The finest level's samples.
    pub grid: Grid,
    /// Number of levels.
    pub levels: u32,
    /// Facts by level, row-major from the south-west.
    facts: Vec<Vec<TileFacts>>,
}

impl Pyramid {
    /// Measures every tile. The grid's side must be `64 * 2^(levels-1) + 1`.
    pub fn new(grid: Grid, levels: u32) -> Self {
        assert_eq!(grid.side, (CELLS << (levels - 1)) + 1, "the grid was sampled for this pyramid");
        let mut facts: Vec<Vec<TileFacts>> = Vec::new();
        for level in (0..levels).rev() {
            let tiles = 1usize << level;
            let finer = facts.last();
            let measured: Vec<TileFacts> = (0..tiles * tiles)
                .into_par_iter()
                .map(|t| {
                    let (x, y) = (t % tiles, t / tiles);
                    let mut f = measure(&grid, levels, level, x, y);
                    if let Some(finer) = finer {
                        for (cx, cy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                            let child = finer[(2 * y + cy) * 2 * tiles + 2 * x + cx];
                            f.error_m = f.error_m.max(child.error_m);
                        }
                        // A flat parent of flat children still has to give way to them.
                        f.error_m = f.error_m.max(crate::grid::QUANTUM_M);
                    }
                    f
                })
                .collect();
            facts.push(measured);
        }
        facts.reverse();
        Self { grid, levels, facts }
    }

    /// Samples between neighbouring vertices of a level.
    pub fn stride(&self, level: u32) -> usize {
        1 << (self.levels - 1 - level)
    }

    /// Facts of a tile.
    pub fn facts(&self, key: TileKey) -> TileFacts {
        self.facts[key.level as usize][((key.y << key.level) + key.x) as usize]
    }

    /// All tiles, coarse first.
    pub fn keys(&self) -> impl Iterator<Item = TileKey> {
        (0..self.levels).flat_map(|level| {
            (0..1u32 << level).flat_map(move |y| (0..1 << level).map(move |x| TileKey { level, x, y }))
        })
    }

    /// Where a tile lies.
    pub fn extent(&self, key: TileKey) -> Extent {
        let e = self.grid.extent;
        let n = f64::from(1u32 << key.level);
        let lon = |t: f64| e.west + (e.east - e.west) * (t / n);
        let lat = |t: f64| e.south + (e.north - e.south) * (t / n);
        let (x, y) = (f64::from(key.x), f64::from(key.y));
        Extent { west: lon(x), south: lat(y), east: lon(x + 1.0), north: lat(y + 1.0) }
    }

    /// Height of vertex (i, j) of a tile, i east and j north; outside the set the nearest vertex inside.
    pub fn height_m(&self, key: TileKey, i: i64, j: i64) -> f32 {
        let stride = self.stride(key.level) as i64;
        let last = self.grid.side as i64 - 1;
        let at = |tile: u32, v: i64| ((i64::from(tile) * CELLS as i64 + v) * stride).clamp(0, last) as usize;
        self.grid.heights[at(key.y, j) * self.grid.side + at(key.x, i)]
    }

    /// Errors by level, root first, for switching whole levels: the largest of the level, each at least 1.5 times the
    /// next finer (so that the ranges in which neighbouring levels morph follow each other), the finest 0.
    pub fn level_errors_m(&self) -> Vec<f64> {
        let mut errors = vec![0.0f64; self.levels as usize];
        for level in (0..self.levels as usize - 1).rev() {
            let largest = self.facts[level].iter().map(|f| f.error_m).fold(0.0, f64::max);
            errors[level] = largest.max(1.5 * errors[level + 1]).max(crate::grid::QUANTUM_M);
        }
        errors
    }
}

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
            for ci in 0..CELLS {
                let (i, j) = (x0 + ci * stride, y0 + cj * stride);
                let corner = |di: usize, dj: usize| f64::from(at(i + di * stride, j + dj * stride));
                let (sw, se, nw, ne) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
                for b in 0..=stride {
                    for a in 0..=stride {
                        let (u, v) = (a as f64 * step, b as f64 * step);
                        let surface = if u >= v {
                            sw + u * (se - sw) + v * (ne - se)
                        } else {
                            sw + v * (nw - sw) + u * (ne - nw)
                        };
                        error = error.max((surface - f64::from(at(i + a, j + b))).abs());
                    }
                }
            }
        }
    }
    TileFacts { error_m: error, min_height_m: low, max_height_m: high }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ElevationSource, Procedural};

    fn pyramid() -> Pyramid {
        let source = Procedural { seed: 7, cos_latitude: 0.68 };
        let extent = Extent { west: 0.139, south: 0.82, east: 0.141, north: 0.8215 };
        Pyramid::new(Grid::sample(&source as &dyn ElevationSource, extent, 257), 3)
    }

    #[test]
    fn shared_vertices_are_equal_bits() {
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

    #[test]
    fn errors_are_what_brute_force_finds_and_never_below_a_child() {
        let p = pyramid();
        for key in p.keys().filter(|k| k.level + 1 < p.levels) {
            let s = p.stride(key.level);
            let mut worst = 0.0f64;
            for fj in 0..=64 * s {
                for fi in 0..=64 * s {
                    let (ci, cj) = ((fi / s).min(63), (fj / s).min(63));
                    let (u, v) = ((fi - ci * s) as f64 / s as f64, (fj - cj * s) as f64 / s as f64);
                    let h = |i: usize, j: usize| f64::from(p.height_m(key, i as i64, j as i64));
                    let (sw, ne) = (h(ci, cj), h(ci + 1, cj + 1));
                    // Barycentric, the other way round than the measured one.
                    let surface = if u >= v {
                        sw * (1.0 - u) + h(ci + 1, cj) * (u - v) + ne * v
                    } else {
                        sw * (1.0 - v) + h(ci, cj + 1) * (v - u) + ne * u
                    };
                    let (gi, gj) = (key.x as usize * 64 * s + fi, key.y as usize * 64 * s + fj);
                    worst = worst.max((surface - f64::from(p.grid.heights[gj * p.grid.side + gi])).abs());
                }
            }
            let mut expected = worst;
            for (cx, cy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let child = TileKey { level: key.level + 1, x: 2 * key.x + cx, y: 2 * key.y + cy };
                assert!(p.facts(key).error_m >= p.facts(child).error_m);
                expected = expected.max(p.facts(child).error_m);
            }
            assert!((p.facts(key).error_m - expected).abs() < 1e-9, "{key:?}");
        }
        let errors = p.level_errors_m();
        assert!(errors.windows(2).all(|w| w[0] > w[1] && w[0] >= 1.5 * w[1]), "{errors:?}");
    }
}
