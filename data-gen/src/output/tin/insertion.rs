//! Greedy insertion of samples into the triangulation of a tile, in rounds.

use super::distance::largest_distance_m;
use super::rows::Rows;
use super::shapes::{SHAPES, Shapes};
use super::surface::STRIDE;
use super::triangulation::{Point, Triangulation, turn};
use super::{ALLOWED_SHARE, MIN_ALLOWED_M, Surface, Tin};

/// The farthest sample of a triangle.
#[derive(Clone, Copy, Default)]
struct Farthest {
    /// The distance in metres; 0 without samples.
    distance_m: f64,
    sample: Point,
}

/// Triangulates a tile. `edges` are the positions of the vertices on the southern, eastern, northern and western edge, counted
/// from the west or the south.
///
/// Samples at bends of the surface come first. Each round then inserts the farthest sample of every triangle, the largest
/// distance first, unless a sample before has moved the triangles close enough to it. That takes a third of the measurements of
/// one sample at a time.
///
/// No sample with data is farther from the triangles than the allowed distance. That is [`ALLOWED_SHARE`] of the error of a grid
/// with half as many cells, at most `limit_m`, and at least half a step of the heights. Between samples the distance may be
/// larger where a triangle's edge crosses a ridge; [`Tin::distance_m`] is the largest of all.
pub(crate) fn triangulate(surface: &Surface, edges: &[Vec<u16>; 4], limit_m: f64) -> Tin {
    let last = (surface.side() - 1) as i32;
    let mut net = Triangulation::new(last);
    for (edge, places) in edges.iter().enumerate() {
        for place in places {
            let k = i32::from(*place);
            net.insert_anywhere([[k, 0], [last, k], [k, last], [0, k]][edge]);
        }
    }
    if !surface.is_whole() {
        let samples = (1..last).flat_map(|j| (1..last).map(move |i| [i, j]));
        samples.filter(|sample| surface.is_border(*sample)).for_each(|sample| net.insert_anywhere(sample));
    }
    let allowed_m = (ALLOWED_SHARE * surface.halved_error_m()).min(limit_m).max(MIN_ALLOWED_M);
    insert_bends(surface, allowed_m, &mut net);
    let mut changed = Vec::new();
    net.take_changed(&mut changed);
    // All triangles are new.
    changed = (0..net.len() as u16).collect();
    let shapes = &*SHAPES;
    let mut far: Vec<Farthest> = Vec::new();
    // The bits of the distance, which order positive numbers, above those of the triangle, of which the first comes first.
    let mut round: Vec<u64> = Vec::new();
    while !changed.is_empty() {
        far.resize(net.len(), Farthest::default());
        round.clear();
        for &triangle in &changed {
            let corners = net.corners(triangle);
            let is_outer = net.outer_edges(triangle).contains(&true);
            let farthest = farthest(surface, (!is_outer).then_some(shapes), corners, last);
            far[usize::from(triangle)] = farthest;
            if farthest.distance_m > allowed_m {
                round.push(u64::from((farthest.distance_m as f32).to_bits()) << 32 | u64::from(!u32::from(triangle)));
            }
        }
        round.sort_unstable();
        for triangle in round.iter().rev().map(|key| !(*key as u32) as u16) {
            let sample = far[usize::from(triangle)].sample;
            let mut near = triangle;
            if net.is_changed(triangle) {
                near = net.find(sample, triangle);
                let plane = Plane::new(surface, net.corners(near));
                if (plane.at(sample) - surface.at(sample)).abs() <= allowed_m {
                    continue;
                }
            }
            net.insert(sample, near);
        }
        net.take_changed(&mut changed);
    }
    let at_samples_m = far.iter().map(|farthest| farthest.distance_m).fold(0.0, f64::max);
    finish(surface, &net, at_samples_m)
}

/// Inserts the samples where the surface bends most. Nearly every triangulation needs them. Each square of 3 x 3 samples has
/// one: the farthest from the middle of its neighbours, if that is more than the allowed distance. Without them about the same
/// vertices would be found in more rounds over larger triangles.
fn insert_bends(surface: &Surface, allowed_m: f64, net: &mut Triangulation) {
    /// The steps from one square to the next. Few far from each other come first, so that triangles are seldom long.
    const STEPS: [i32; 4] = [8, 4, 2, 1];
    let squares = (surface.side() - 2).div_ceil(SQUARE as usize) as i32;
    for step in STEPS {
        for row in (0..squares).step_by(step as usize) {
            for column in (0..squares).step_by(step as usize) {
                // There and back, so that a square lies near the one before.
                let column = if row & step == 0 { column } else { (squares - 1) / step * step - column };
                let is_new = step == STEPS[0] || (row | column) & step != 0;
                if let Some(sample) = is_new.then(|| largest_bend(surface, allowed_m, [column, row])).flatten() {
                    net.insert_anywhere(sample);
                }
            }
        }
    }
}

/// The samples along a side of a square of which [`insert_bends`] inserts one.
const SQUARE: i32 = 3;

/// Returns the sample of a square at which the surface bends most, if that is more than allowed.
#[inline(always)]
fn largest_bend(surface: &Surface, allowed_m: f64, square: [i32; 2]) -> Option<Point> {
    let last = (surface.side() - 1) as i32;
    let [x, y] = square.map(|k| 1 + SQUARE * k);
    let (mut largest_m, mut found) = (allowed_m, None);
    for j in y..(y + SQUARE).min(last) {
        for (i, bend_m) in (x..last).zip(surface.bends_m(j, x, (x + SQUARE).min(last))) {
            if bend_m > largest_m && surface.is_used([i, j]) {
                (largest_m, found) = (bend_m, Some([i, j]));
            }
        }
    }
    found
}

/// Returns the triangles with data, in strips. `at_samples_m` is the largest distance at samples inside of the tile.
fn finish(surface: &Surface, net: &Triangulation, at_samples_m: f64) -> Tin {
    let mut numbers = [0; STRIDE * STRIDE];
    for (point, number) in net.points().zip(0..) {
        numbers[Surface::index(point)] = number;
    }
    let kept = net.in_strips(|triangle| has_data(surface, net.corners(triangle)));
    Tin {
        vertices: net.points().map(|point| point.map(|c| c as u16)).collect(),
        triangles: kept.iter().map(|t| net.corners(*t).map(|corner| numbers[Surface::index(corner)])).collect(),
        is_ordered: true,
        distance_m: at_samples_m.max(largest_distance_m(surface, net, &kept)),
    }
}

/// Returns true if a triangle covers cells with data. All samples on borders of voids are vertices, so that a triangle covers
/// only cells with data or only cells without: those at its centre decide.
fn has_data(surface: &Surface, corners: [Point; 3]) -> bool {
    if surface.is_whole() {
        return true;
    }
    let [x, y] = [0, 1].map(|k| corners.iter().map(|corner| corner[k]).sum::<i32>());
    let [south_east, north_west] = surface.data([x / 3, y / 3]);
    if x % 3 >= y % 3 { south_east } else { north_west }
}

/// Returns the sample inside of a triangle or on its edges that is farthest from it. The samples on the edges of the tile do not
/// count. `shapes` is given for triangles that have no edge there.
#[inline(always)]
fn farthest(surface: &Surface, shapes: Option<&Shapes>, corners: [Point; 3], last: i32) -> Farthest {
    let mut found = Farthest::default();
    // A small triangle has no samples but its corners.
    let turn = turn(corners[0], corners[1], corners[2]);
    if turn == 1 || !has_data(surface, corners) {
        return found;
    }
    if let Some((samples, inverse)) = shapes.and_then(|shapes| shapes.inside(corners, turn)) {
        let ([a_m, b_m, c_m], values_m) = (corners.map(|corner| surface.at(corner)), surface.values_m());
        let (rise_b, rise_c) = ((b_m - a_m) * inverse, (c_m - a_m) * inverse);
        let first = Surface::index(corners[0]);
        let mut at = first;
        for sample in samples {
            let index = first.wrapping_add_signed(isize::from(sample.offset));
            let [b, c] = sample.shares.map(f64::from);
            let distance_m = (a_m + b * rise_b + c * rise_c - values_m[index]).abs();
            let is_farther = distance_m > found.distance_m;
            at = if is_farther { index } else { at };
            found.distance_m = if is_farther { distance_m } else { found.distance_m };
        }
        found.sample = [at % STRIDE, at / STRIDE].map(|c| c as i32);
        return found;
    }
    let plane = Plane::new(surface, corners);
    for (y, from, to) in Rows::new(corners, last) {
        let mut value_m = plane.at([from, y]);
        for (x, height_m) in (from..).zip(surface.row(y, from, to)) {
            let distance_m = (value_m - height_m).abs();
            if distance_m > found.distance_m {
                found = Farthest { distance_m, sample: [x, y] };
            }
            value_m += plane.east_m;
        }
    }
    found
}

/// The plane of a triangle.
struct Plane {
    corner: Point,
    corner_m: f64,
    /// The rise in metres of a cell eastwards.
    east_m: f64,
    /// The rise in metres of a cell northwards.
    north_m: f64,
}

impl Plane {
    fn new(surface: &Surface, [a, b, c]: [Point; 3]) -> Self {
        let [value_m, rise_b, rise_c] = [surface.at(a), surface.at(b) - surface.at(a), surface.at(c) - surface.at(a)];
        let [bx, by, cx, cy] = [b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]].map(f64::from);
        let area = 1.0 / (bx * cy - by * cx);
        let east_m = (rise_b * cy - rise_c * by) * area;
        Self { corner: a, corner_m: value_m, east_m, north_m: (rise_c * bx - rise_b * cx) * area }
    }

    /// Returns the value at a sample in metres.
    fn at(&self, [x, y]: Point) -> f64 {
        self.corner_m + self.east_m * f64::from(x - self.corner[0]) + self.north_m * f64::from(y - self.corner[1])
    }
}

#[cfg(test)]
mod tests {
    use super::super::edge_vertices;
    use super::*;

    const SIDE: usize = 33;

    /// Rough terrain of hills, without a seam between tiles.
    fn height_m(i: i64, j: i64) -> f32 {
        let (x, y) = (i as f32, j as f32);
        let rough = (i * 7919 + j * 104_729 + i * j * 31).rem_euclid(97) as f32 / 97.0;
        40.0 * (0.21 * x).sin() * (0.17 * y + 1.0).cos() + 9.0 * (0.9 * x + 0.4 * y).sin() + 2.0 * rough
    }

    /// The tile at `x` tiles east of another one.
    fn tile(x: i64, has_data: Option<&dyn Fn(i64, i64) -> [bool; 2]>) -> (Surface, [Vec<u16>; 4], Tin) {
        let last = SIDE as i64 - 1;
        let height = |i: i64, j: i64| height_m(x * last + i, j);
        let moved = has_data.map(|has_data| move |i: i64, j: i64| has_data(x * last + i, j));
        let has_data = moved.as_ref().map(|f| f as &dyn Fn(i64, i64) -> [bool; 2]);
        let surface = Surface::new(SIDE, height, |_| [0.01, 0.01], has_data);
        let edge = |at: fn(i64, i64) -> [i64; 2]| {
            let places: Vec<[i64; 2]> = (0..=last).map(|k| at(k, last)).collect();
            let heights: Vec<f32> = places.iter().map(|[i, j]| height(*i, *j)).collect();
            edge_vertices(&heights, 0.01, f64::INFINITY, |k| surface.is_border(places[k].map(|c| c as i32)))
        };
        let edges = [edge(|k, _| [k, 0]), edge(|k, l| [l, k]), edge(|k, l| [k, l]), edge(|k, _| [0, k])];
        let tin = triangulate(&surface, &edges, f64::INFINITY);
        (surface, edges, tin)
    }

    /// Returns the value of the triangles at a position, if one covers it.
    fn value_at(surface: &Surface, tin: &Tin, [x, y]: [f64; 2]) -> Option<f64> {
        tin.triangles.iter().find_map(|triangle| {
            let corners = triangle.map(|v| tin.vertices[usize::from(v)].map(i32::from));
            let weight = |k: usize| {
                let ([px, py], [qx, qy]) = (corners[(k + 1) % 3].map(f64::from), corners[(k + 2) % 3].map(f64::from));
                (qx - px) * (y - py) - (qy - py) * (x - px)
            };
            let weights = [0, 1, 2].map(weight);
            let area: f64 = weights.iter().sum();
            let is_inside = weights.iter().all(|w| *w >= -1e-9);
            is_inside.then(|| (0..3).map(|k| weights[k] / area * surface.at(corners[k])).sum())
        })
    }

    /// Returns the value of the grid's triangles at a position.
    fn grid_at(surface: &Surface, [x, y]: [f64; 2]) -> f64 {
        let last = SIDE as i32 - 2;
        let (i, j) = ((x as i32).min(last), (y as i32).min(last));
        let (u, v) = (x - f64::from(i), y - f64::from(j));
        let [sw, se, nw, ne] = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[di, dj]| surface.at([i + di, j + dj]));
        if u >= v { sw + u * (se - sw) + v * (ne - se) } else { sw + v * (nw - sw) + u * (ne - nw) }
    }

    #[test]
    fn distances_hold_at_samples_and_between_them() {
        let (surface, _, tin) = tile(0, None);
        let allowed_m = ALLOWED_SHARE * surface.halved_error_m();
        let (mut at_samples_m, mut anywhere_m) = (0.0f64, 0.0f64);
        let parts = 4;
        for (i, j) in (0..=32 * parts * 32 * parts + 64 * parts).map(|k| (k % (32 * parts + 1), k / (32 * parts + 1))) {
            let place = [i, j].map(|c| f64::from(c) / f64::from(parts));
            let distance_m = (value_at(&surface, &tin, place).unwrap() - grid_at(&surface, place)).abs();
            anywhere_m = anywhere_m.max(distance_m);
            if i % parts == 0 && j % parts == 0 {
                at_samples_m = at_samples_m.max(distance_m);
            }
        }
        assert!(allowed_m > 0.5 && at_samples_m <= allowed_m + 1e-9, "{at_samples_m} of {allowed_m}");
        assert!(anywhere_m <= tin.distance_m + 1e-9, "{anywhere_m} of {}", tin.distance_m);
        assert!(tin.distance_m < 1.2 * anywhere_m, "{anywhere_m} of {}", tin.distance_m);
        assert!(tin.triangles.len() < 32 * 32, "{} triangles", tin.triangles.len());
    }

    #[test]
    fn flat_land_needs_two_triangles_or_those_of_the_round_earth() {
        let flat = |curvature_m: f64| {
            let surface = Surface::new(SIDE, |_, _| 100.0, |_| [curvature_m; 2], None);
            let edge = edge_vertices(&[100.0; SIDE], curvature_m, f64::INFINITY, |_| false);
            triangulate(&surface, &[edge.clone(), edge.clone(), edge.clone(), edge], f64::INFINITY)
        };
        let plain = flat(0.0);
        assert_eq!((plain.triangles.len(), plain.distance_m), (2, 0.0));
        // Cells of half as many fall short by 8 m at their centres; the triangles by at most 2 m.
        let round = flat(4.0);
        assert!(round.triangles.len() > 500 && round.distance_m <= 2.0 + 1e-9, "{}", round.distance_m);
    }

    #[test]
    fn bends_are_vertices_and_slopes_have_none() {
        // A slope with a spike, and a step of less than what is allowed.
        let height_m =
            |i: i64, j: i64| 2.0 * i as f32 + if [i, j] == [11, 20] { 8.0 } else { 0.5 * f32::from(u8::from(j > 25)) };
        let surface = Surface::new(SIDE, height_m, |_| [0.0; 2], None);
        let mut net = Triangulation::new(SIDE as i32 - 1);
        insert_bends(&surface, 1.0, &mut net);
        // The spike and its neighbours lie in four squares, each of which has one.
        let found: Vec<Point> = net.points().skip(4).collect();
        assert!(found.contains(&[11, 20]) && found.len() <= 4, "{found:?}");
        assert!(found.iter().all(|[x, y]| (x - 11).abs() + (y - 20).abs() <= 1), "{found:?}");
    }

    /// Half-cells without data: a disk that the edge of two tiles crosses.
    fn outside_of_disk(i: i64, j: i64) -> [bool; 2] {
        let is_outside = |i: i64, j: i64| (i - 32).pow(2) + (j - 15).pow(2) > 49;
        let diagonal = is_outside(i, j) && is_outside(i + 1, j + 1);
        [diagonal && is_outside(i + 1, j), diagonal && is_outside(i, j + 1)]
    }

    #[test]
    fn voids_stay_cut_and_neighbours_have_the_same_edge() {
        let places = |vertices: &[[u16; 2]], column: u16| {
            let mut rows: Vec<u16> = vertices.iter().filter(|v| v[0] == column).map(|v| v[1]).collect();
            rows.sort_unstable();
            rows
        };
        for has_data in [None, Some(&outside_of_disk as &dyn Fn(i64, i64) -> [bool; 2])] {
            let (west, east) = (tile(0, has_data), tile(1, has_data));
            assert_eq!(west.1[1], east.1[3]);
            assert_eq!(places(&west.2.vertices, 32), west.1[1]);
            assert_eq!(places(&east.2.vertices, 0), west.1[1]);
            for (x, (surface, _, tin)) in [(0, &west), (1, &east)] {
                // Each half-cell is covered exactly if it has data.
                for (i, j, half) in (0..32 * 64).map(|k| (k % 32, k / 64, k / 32 % 2)) {
                    let center = [[2.0, 1.0], [1.0, 2.0]][half].map(|c| c / 3.0);
                    let place = [i as f64 + center[0], j as f64 + center[1]];
                    let expected = has_data.is_none_or(|has_data| has_data(x * 32 + i as i64, j as i64)[half]);
                    assert_eq!(value_at(surface, tin, place).is_some(), expected, "{i} {j} {half}");
                }
            }
        }
    }
}
