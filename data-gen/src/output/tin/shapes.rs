//! Tables of small triangles and short edges: the offsets of the samples on them from the first corner. Most triangles are
//! small, and going through their rows would take longer than the samples.

use std::sync::LazyLock;

use super::rows::Rows;
use super::surface::STRIDE;
use super::triangulation::{Point, turn};

/// The largest distance of corners from the first one, in columns and in rows.
const MAX_REACH: i32 = 6;
/// The largest double area of triangles.
const MAX_TURN: i32 = 24;
/// The largest length of edges in columns and in rows.
const MAX_LENGTH: i32 = 8;

/// All small triangles and short edges.
pub(super) static SHAPES: LazyLock<Shapes> = LazyLock::new(Shapes::new);

/// A sample of a triangle.
#[derive(Clone, Copy)]
pub(super) struct Inside {
    /// Its offset in [`super::Surface`] from the first corner.
    pub offset: i16,
    /// The shares of the second and of the third corner, times the double area of the triangle.
    pub shares: [u8; 2],
}

/// Four points at which an edge crosses lines of the grid between two samples. Unused ones are the start of the edge.
#[derive(Clone, Copy, Default)]
pub(super) struct Crossings {
    /// The offsets in [`super::Surface`] of the samples before, from the start of the edge, and those of the samples behind
    /// from the ones before.
    pub offsets: [i16; 4],
    pub steps: [i16; 4],
    /// The parts of the edge that lie before.
    pub shares: [f64; 4],
    /// The parts of the way from the sample before to the one behind.
    pub besides: [f64; 4],
}

/// See [`SHAPES`].
pub(super) struct Shapes {
    /// For the offsets of the second and the third corner, the index of their first element in `inside`. One more at the end.
    triangles: Vec<u32>,
    inside: Vec<Inside>,
    /// For the offset of the end, the index of its first element in `crossings`. One more at the end.
    edges: Vec<u32>,
    crossings: Vec<Crossings>,
    /// One over double areas.
    inverses: [f64; MAX_TURN as usize + 1],
}

impl Shapes {
    fn new() -> Self {
        let mut shapes = Self {
            triangles: vec![0],
            inside: Vec::new(),
            edges: vec![0],
            crossings: Vec::new(),
            inverses: std::array::from_fn(|turn| 1.0 / turn as f64),
        };
        let within = |reach: i32| (-reach..=reach).flat_map(move |y| (-reach..=reach).map(move |x| [x, y]));
        for (b, c) in within(MAX_REACH).flat_map(|b| within(MAX_REACH).map(move |c| (b, c))) {
            shapes.add_triangle(b, c);
            shapes.triangles.push(shapes.inside.len() as u32);
        }
        for end in within(MAX_LENGTH) {
            shapes.crossings.extend(crossings_of(end));
            shapes.edges.push(shapes.crossings.len() as u32);
        }
        shapes
    }

    fn add_triangle(&mut self, b: Point, c: Point) {
        let area = turn([0, 0], b, c);
        if !(1..=MAX_TURN).contains(&area) {
            return;
        }
        // Far from the edges of the largest square.
        let moved = |point: Point| point.map(|c| c + 2 * MAX_REACH);
        for (y, from, to) in Rows::new([[0, 0], b, c].map(moved), 4 * MAX_REACH) {
            let samples = (from..=to).map(|x| [x, y].map(|c| c - 2 * MAX_REACH));
            self.inside.extend(samples.filter(|sample| ![[0, 0], b, c].contains(sample)).map(|sample| Inside {
                offset: (sample[1] * STRIDE as i32 + sample[0]) as i16,
                shares: [turn([0, 0], sample, c), turn([0, 0], b, sample)].map(|share| share as u8),
            }));
        }
    }

    /// Returns the samples of a small triangle without its corners, those on its edges included, and one over its double area.
    /// `None` for a larger one.
    #[inline(always)]
    pub fn inside(&self, [a, b, c]: [Point; 3], turn: i32) -> Option<(&[Inside], f64)> {
        const SIDE: i32 = 2 * MAX_REACH + 1;
        let [bx, by, cx, cy] = [b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]].map(|d| d + MAX_REACH);
        if turn > MAX_TURN || [bx, by, cx, cy].iter().any(|d| d.cast_unsigned() >= SIDE as u32) {
            return None;
        }
        Some((
            part(&self.inside, &self.triangles, ((by * SIDE + bx) * SIDE + cy) * SIDE + cx),
            self.inverses[turn as usize],
        ))
    }

    /// Returns where an edge crosses columns, rows and diagonals of the grid between samples; `None` for a long one.
    #[inline(always)]
    pub fn crossings(&self, [x, y]: Point) -> Option<&[Crossings]> {
        const SIDE: i32 = 2 * MAX_LENGTH + 1;
        let [x, y] = [x, y].map(|d| d + MAX_LENGTH);
        let is_short = [x, y].iter().all(|d| d.cast_unsigned() < SIDE as u32);
        is_short.then(|| part(&self.crossings, &self.edges, y * SIDE + x))
    }
}

/// Returns the part of a list that a number has.
#[inline(always)]
fn part<'a, T>(list: &'a [T], firsts: &[u32], number: i32) -> &'a [T] {
    let number = number as usize;
    &list[firsts[number] as usize..firsts[number + 1] as usize]
}

/// Returns where an edge with some columns and rows crosses columns, rows and diagonals of the grid between samples. They come in
/// fours, so that loops over them have one length.
pub(super) fn crossings_of([dx, dy]: Point) -> Vec<Crossings> {
    let (mut all, mut count) = (vec![Crossings::default()], 0);
    // For each family of lines: the number of lines to the other end, and the step along a line to its next sample.
    for (lines, step) in [(dx, [0, 1]), (dy, [1, 0]), (dx - dy, [1, 1])] {
        let number = lines.abs();
        // Along a line positions are rows on columns and diagonals, else columns.
        let change = if step == [1, 0] { dx } else { dy };
        for line in 1..number {
            let beside = (line * change).rem_euclid(number);
            // At a sample, which was measured.
            if beside == 0 {
                continue;
            }
            let (whole, line_number) = ((line * change - beside) / number, line * lines.signum());
            let sample = match step {
                [0, _] => [line_number, whole],
                [_, 0] => [whole, line_number],
                _ => [line_number + whole, whole],
            };
            if count == 4 {
                all.push(Crossings::default());
                count = 0;
            }
            let (last, share) = (all.len() - 1, 1.0 / f64::from(number));
            let offset = |[x, y]: Point| (y * STRIDE as i32 + x) as i16;
            (all[last].offsets[count], all[last].steps[count]) = (offset(sample), offset(step));
            all[last].shares[count] = share * f64::from(line);
            all[last].besides[count] = share * f64::from(beside);
            count += 1;
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_triangles_have_the_samples_of_their_rows_with_their_shares() {
        let a = [20, 30];
        let corners = |k: i32| [a, [a[0] + k % 13 - 6, a[1] + k / 13 % 13 - 6], [a[0] + k % 7 - 3, a[1] + k % 11 - 5]];
        let mut count = 0;
        for [a, b, c] in (0..20_000).map(corners) {
            let area = turn(a, b, c);
            let Some((inside, inverse)) = (area > 0).then(|| SHAPES.inside([a, b, c], area)).flatten() else {
                continue;
            };
            let rows = Rows::new([a, b, c], 64).flat_map(|(y, from, to)| (from..=to).map(move |x| [x, y]));
            let samples: Vec<Point> = rows.filter(|sample| ![a, b, c].contains(sample)).collect();
            let first = a[1] * STRIDE as i32 + a[0];
            let offsets: Vec<i32> = samples.iter().map(|[x, y]| y * STRIDE as i32 + x - first).collect();
            assert!(inside.iter().map(|inside| i32::from(inside.offset)).eq(offsets), "{a:?} {b:?} {c:?}");
            for (inside, sample) in inside.iter().zip(samples) {
                let [p, q] = inside.shares.map(|share| inverse * f64::from(share));
                let at = [0, 1].map(|k| (1.0 - p - q) * f64::from(a[k]) + p * f64::from(b[k]) + q * f64::from(c[k]));
                assert!((0..2).all(|k| (at[k] - f64::from(sample[k])).abs() < 1e-12), "{a:?} {b:?} {c:?}");
            }
            count += 1;
        }
        assert!(count > 1000);
        assert!(
            SHAPES.inside([[0, 0], [7, 0], [0, 1]], 7).is_none()
                && SHAPES.inside([[0, 0], [5, 0], [0, 5]], 25).is_none()
        );
    }

    #[test]
    fn edges_cross_columns_rows_and_diagonals() {
        let of = |end: Point| {
            let found = SHAPES.crossings(end).map_or_else(|| crossings_of(end), <[Crossings]>::to_vec);
            let places =
                found.iter().flat_map(|c| (0..4).map(|k| (c.offsets[k], c.steps[k], c.shares[k], c.besides[k])));
            places.filter(|(_, step, ..)| *step != 0).collect::<Vec<_>>()
        };
        let stride = STRIDE as i16;
        assert_eq!(of([2, 1]), [(1, stride, 0.5, 0.5)]);
        assert_eq!(of([1, -1]), [(-stride, stride + 1, 0.5, 0.5)]);
        assert!(of([1, 1]).is_empty() && of([5, 0]).is_empty());
        // Each column, row and diagonal between the ends; long edges as well.
        assert_eq!((of([7, -5]).len(), of([17, -5]).len()), (6 + 4 + 11, 16 + 4 + 21));
        assert!(SHAPES.crossings([8, -8]).is_some() && SHAPES.crossings([9, 0]).is_none());
    }
}
