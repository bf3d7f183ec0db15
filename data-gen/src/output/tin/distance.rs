//! The largest distance between the triangles of a tile and those of its grid.

use super::Surface;
use super::insertion::Plane;
use super::triangulation::{Point, Triangulation, rows};

/// Returns the largest vertical distance in metres between some triangles and the grid. The edges of both surfaces divide them
/// into flat parts. So the largest distance is at a sample, or where an edge of a triangle crosses an edge of the grid.
pub(super) fn largest_distance_m(surface: &Surface, net: &Triangulation, triangles: &[u32]) -> f64 {
    let mut largest_m = 0.0f64;
    for &triangle in triangles {
        let corners = net.corners(triangle);
        largest_m = largest_m.max(at_samples_m(surface, corners));
        let owned = net.owns_edges(triangle);
        for k in (0..3).filter(|k| owned[*k] || !surface.is_whole()) {
            largest_m = largest_m.max(at_crossings_m(surface, corners[k], corners[(k + 1) % 3]));
        }
    }
    largest_m
}

/// Returns the largest distance at samples inside of a triangle and on its edges.
fn at_samples_m(surface: &Surface, corners: [Point; 3]) -> f64 {
    let plane = Plane::new(surface, corners);
    let mut largest_m = 0.0f64;
    for (y, from, to) in rows(corners).filter(|(_, from, to)| from <= to) {
        for (x, height_m) in (from..).zip(surface.row(y, from, to)) {
            largest_m = largest_m.max((plane.at([x, y]) - height_m).abs());
        }
    }
    largest_m
}

/// Returns the largest distance where an edge of a triangle crosses the lines of the grid: columns, rows and diagonals.
fn at_crossings_m(surface: &Surface, from: Point, to: Point) -> f64 {
    let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    let (start_m, rise_m) = (surface.at(from), surface.at(to) - surface.at(from));
    let mut largest_m = 0.0f64;
    // For each family of lines: the number of the line at both ends, and the step along a line to its next sample.
    let families = [(from[0], dx, [0, 1]), (from[1], dy, [1, 0]), (from[0] - from[1], dx - dy, [1, 1])];
    for (first, lines, step) in families {
        for line in 1..lines.abs() {
            let t = f64::from(line) / f64::from(lines.abs());
            let number = first + line * lines.signum();
            // The position along the line, in samples: the row on columns and diagonals, else the column.
            let (start, change) = if step == [1, 0] { (from[0], dx) } else { (from[1], dy) };
            let position = f64::from(start) + t * f64::from(change);
            let sample = position.floor();
            let k = sample as i32;
            let on_line = match step {
                [0, _] => [number, k],
                [_, 0] => [k, number],
                _ => [number + k, k],
            };
            let beside = position - sample;
            // At a sample, which was measured. Rounding may put it just before the sample, outside of the tile.
            if !(1e-9..1.0 - 1e-9).contains(&beside) {
                continue;
            }
            let value_m = surface.at(on_line);
            let next_m = surface.at([on_line[0] + step[0], on_line[1] + step[1]]);
            let grid_m = value_m + beside * (next_m - value_m);
            largest_m = largest_m.max((start_m + t * rise_m - grid_m).abs());
        }
    }
    largest_m
}
