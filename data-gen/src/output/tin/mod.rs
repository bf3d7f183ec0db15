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
//! | `insertion` | greedy insertion inside a tile |
//! | `distance` | the largest distance between the triangles and the grid |

mod distance;
mod edge;
mod insertion;
mod surface;
mod triangulation;

pub(crate) use edge::edge_vertices;
pub(crate) use insertion::triangulate;
pub(crate) use surface::Surface;

/// The allowed distance, as a share of the error that a grid with half as many cells would have against the same samples. That
/// error is about the one of the next coarser level, so the triangles of a level are finer than those of the one above.
pub(crate) const ALLOWED_SHARE: f64 = 0.25;

/// The smallest allowed distance in metres, half a step of the heights.
const MIN_ALLOWED_M: f64 = 1.0 / 256.0;

/// The triangles of a tile.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tin {
    /// The column and the row of each vertex, from the south-west.
    pub vertices: Vec<[u16; 2]>,
    /// The vertices of each triangle, counter-clockwise seen from above. Triangles without data are left out.
    pub triangles: Vec<[u16; 3]>,
    /// The largest vertical distance in metres between the triangles and those of the whole grid, at any position.
    pub distance_m: f64,
}
