//! Triangulated irregular networks: a tile's grid of samples as few triangles, within an allowed vertical distance.
//!
//! Points are inserted greedily where the distance is largest (Garland and Heckbert 1995, Fast Polygonal Approximation of
//! Terrains and Height Fields) into a Delaunay triangulation. The tile's edges come first: [`edge`] simplifies an edge from its
//! own samples alone, so that both tiles at an edge have the same vertices on it. Borders of voids are kept as they are.
//! Called by all threads that write tiles.
//!
//! | file | contents |
//! |---|---|
//! | `surface` | the samples that are triangulated |
//! | `edge` | the vertices on an edge of a tile |
//! | `triangulation` | the Delaunay triangulation of lattice points |
//! | `rows` | the samples of a triangle, row by row |
//! | `shapes` | tables of the samples of small triangles |
//! | `insertion` | greedy insertion inside a tile |
//! | `distance` | the largest distance between the triangles and the grid |

mod distance;
mod edge;
mod insertion;
mod rows;
mod shapes;
mod surface;
mod triangulation;

use edge::edge_vertices;
use insertion::triangulate;
use surface::Surface;

use crate::pyramid::CELLS;

/// The allowed distance, as a share of the error that a grid with half as many cells would have against the same samples. That
/// error is about the one of the next coarser level, so the triangles of a level are finer than those of the one above.
const ALLOWED_SHARE: f64 = 0.25;

/// The smallest allowed distance in metres, half a step of the heights.
const MIN_ALLOWED_M: f64 = 1.0 / 256.0;

/// The triangles of a tile.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tin {
    /// The column and the row of each vertex, from the south-west.
    pub vertices: Vec<[u16; 2]>,
    /// The vertices of each triangle, counter-clockwise seen from above. Triangles without data are left out.
    pub triangles: Vec<[u16; 3]>,
    /// True if the triangles are in an order for GPUs.
    pub is_ordered: bool,
    /// The largest vertical distance in metres between the triangles and those of the whole grid, at any position.
    pub distance_m: f64,
}

impl Tin {
    /// Returns two triangles for each cell. `has_data` returns which of them have data: the south-eastern and the north-western
    /// one.
    pub fn grid(has_data: impl Fn(usize, usize) -> [bool; 2]) -> Self {
        let side = CELLS as u16 + 1;
        let vertices = (0..side).flat_map(|j| (0..side).map(move |i| [i, j])).collect();
        let mut triangles = Vec::with_capacity(2 * CELLS * CELLS);
        for (i, j) in (0..CELLS * CELLS).map(|k| (k % CELLS, k / CELLS)) {
            let at = |di: usize, dj: usize| ((j + dj) * (CELLS + 1) + i + di) as u16;
            let [south_east, north_west] = has_data(i, j);
            triangles.extend(south_east.then(|| [at(0, 0), at(1, 0), at(1, 1)]));
            triangles.extend(north_west.then(|| [at(0, 0), at(1, 1), at(0, 1)]));
        }
        Self { vertices, triangles, is_ordered: false, distance_m: 0.0 }
    }

    /// Returns few triangles for the samples of a tile, by the functions of [`Surface::new`]. Samples are at most the first
    /// limit in metres from them, and closer where the tile is smooth. If the triangles are farther than `most_m` from the grid
    /// between samples, the next limits count for samples inside of the tile; its edges stay, which neighbours have too.
    pub fn of_samples(
        height_m: &dyn Fn(i64, i64) -> f32,
        curvature_m: &dyn Fn(i64) -> [f64; 2],
        has_data: Option<&dyn Fn(i64, i64) -> [bool; 2]>,
        limits_m: &[f64],
        most_m: f64,
    ) -> Self {
        let limit_m = limits_m.first().copied().unwrap_or(f64::INFINITY);
        let surface = Surface::new(CELLS + 1, height_m, curvature_m, has_data);
        let last = CELLS as i64;
        let edge = |at: fn(i64, i64) -> [i64; 2], curvature_m: f64| {
            let places: Vec<[i64; 2]> = (0..=last).map(|k| at(k, last)).collect();
            let heights_m: Vec<f32> = places.iter().map(|[i, j]| height_m(*i, *j)).collect();
            edge_vertices(&heights_m, curvature_m, limit_m, |k| surface.is_border(places[k].map(|c| c as i32)))
        };
        let north_m = curvature_m(last / 2)[1];
        let edges = [
            edge(|k, _| [k, 0], curvature_m(0)[0]),
            edge(|k, last| [last, k], north_m),
            edge(|k, last| [k, last], curvature_m(last)[0]),
            edge(|k, _| [0, k], north_m),
        ];
        let mut tin = triangulate(&surface, &edges, limit_m);
        for limit_m in limits_m.iter().skip(1) {
            if tin.distance_m <= most_m {
                break;
            }
            tin = triangulate(&surface, &edges, *limit_m);
        }
        tin
    }
}
