//! The largest distance between the triangles of a tile and those of its grid.

use super::Surface;
use super::shapes::{Crossings, SHAPES, Shapes, crossings_of};
use super::triangulation::{Point, Triangulation};

/// Returns the largest vertical distance in metres between some triangles and the grid, at the edges of triangles. The edges of
/// both surfaces divide them into flat parts. So the largest distance is at a sample, or where an edge of a triangle crosses an
/// edge of the grid. Samples inside of the tile do not count: the insertion has measured them.
pub(super) fn largest_distance_m(surface: &Surface, net: &Triangulation, triangles: &[u16]) -> f64 {
    let (shapes, mut outer_m, mut inner_m) = (&*SHAPES, 0.0f64, [0.0f64; 4]);
    for &triangle in triangles {
        let corners = net.corners(triangle);
        let (owned, outer) = (net.owns_edges(triangle), net.outer_edges(triangle));
        for k in 0..3 {
            let (from, to) = (corners[k], corners[(k + 1) % 3]);
            if outer[k] {
                outer_m = outer_m.max(at_samples_m(surface, from, to));
            } else if owned[k] || !surface.is_whole() {
                add_crossings(surface, shapes, from, to, &mut inner_m);
            }
        }
    }
    inner_m.into_iter().fold(outer_m, f64::max)
}

/// Returns the largest distance at the samples on an edge of the tile.
fn at_samples_m(surface: &Surface, from: Point, to: Point) -> f64 {
    let step = [0, 1].map(|c| (to[c] - from[c]).signum());
    let cells = (to[0] - from[0]).abs().max((to[1] - from[1]).abs());
    let (start_m, slope_m) = (surface.at(from), (surface.at(to) - surface.at(from)) / f64::from(cells));
    let distance_m = |k: i32| {
        let sample = [0, 1].map(|c| from[c] + k * step[c]);
        (start_m + slope_m * f64::from(k) - surface.at(sample)).abs()
    };
    (1..cells).map(distance_m).fold(0.0, f64::max)
}

/// Adds the largest distance where an edge of a triangle crosses the lines of the grid: columns, rows and diagonals.
#[inline(always)]
fn add_crossings(surface: &Surface, shapes: &Shapes, from: Point, to: Point, largest_m: &mut [f64; 4]) {
    let (start, start_m) = (Surface::index(from), surface.at(from));
    let (values_m, rise_m) = (surface.values_m(), surface.at(to) - start_m);
    let length = [to[0] - from[0], to[1] - from[1]];
    let long;
    let crossings = match shapes.crossings(length) {
        Some(crossings) => crossings,
        None => {
            long = crossings_of(length);
            &long
        }
    };
    for Crossings { offsets, steps, shares, besides } in crossings {
        for k in 0..4 {
            let sample = start.wrapping_add_signed(isize::from(offsets[k]));
            let (value_m, next_m) = (values_m[sample], values_m[sample.wrapping_add_signed(isize::from(steps[k]))]);
            let grid_m = value_m + besides[k] * (next_m - value_m);
            let distance_m = (start_m + shares[k] * rise_m - grid_m).abs();
            largest_m[k] = if distance_m > largest_m[k] { distance_m } else { largest_m[k] };
        }
    }
}
