//! The largest distance between the triangles of a tile and those of its grid.

use super::Surface;
use super::triangulation::{Point, Triangulation};

/// Returns the largest vertical distance in metres between some triangles and the grid, at the edges of triangles. The edges of both
/// surfaces divide them into flat parts. So the largest distance is at a sample, or where an edge of a triangle crosses an edge of
/// the grid. Samples inside of the tile do not count: the insertion has measured them.
pub(super) fn largest_distance_m(surface: &Surface, net: &Triangulation, triangles: &[u32]) -> f64 {
    let mut largest_m = 0.0f64;
    for &triangle in triangles {
        let corners = net.corners(triangle);
        let (owned, outer) = (net.owns_edges(triangle), net.outer_edges(triangle));
        for k in 0..3 {
            let (from, to) = (corners[k], corners[(k + 1) % 3]);
            if outer[k] {
                largest_m = largest_m.max(at_samples_m(surface, from, to));
            } else if owned[k] || !surface.is_whole() {
                largest_m = largest_m.max(at_crossings_m(surface, from, to));
            }
        }
    }
    largest_m
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

/// Returns the largest distance where an edge of a triangle crosses the lines of the grid: columns, rows and diagonals.
fn at_crossings_m(surface: &Surface, from: Point, to: Point) -> f64 {
    let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    let (start_m, rise_m) = (surface.at(from), surface.at(to) - surface.at(from));
    let mut largest_m = 0.0f64;
    // For each family of lines: the number of lines to the other end, and the step along a line to its next sample.
    for (lines, step) in [(dx, [0, 1]), (dy, [1, 0]), (dx - dy, [1, 1])] {
        let count = lines.abs();
        if count < 2 {
            continue;
        }
        let share = 1.0 / f64::from(count);
        // Along a line positions are rows on columns and diagonals, else columns.
        let change = if step == [1, 0] { dx } else { dy };
        let mut moved = 0;
        for line in 1..count {
            moved += change;
            let beside = moved.rem_euclid(count);
            // At a sample, which was measured.
            if beside == 0 {
                continue;
            }
            let whole = (moved - beside) / count;
            let number = line * lines.signum();
            let sample = match step {
                [0, _] => [from[0] + number, from[1] + whole],
                [_, 0] => [from[0] + whole, from[1] + number],
                _ => [from[0] + number + whole, from[1] + whole],
            };
            let value_m = surface.at(sample);
            let next_m = surface.at([sample[0] + step[0], sample[1] + step[1]]);
            let grid_m = value_m + share * f64::from(beside) * (next_m - value_m);
            largest_m = largest_m.max((start_m + share * f64::from(line) * rise_m - grid_m).abs());
        }
    }
    largest_m
}
