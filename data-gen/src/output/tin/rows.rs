//! [`Rows`]: the samples of a triangle, row by row.

use super::triangulation::Point;

/// The largest number of cells along the side of a square whose triangles [`Rows`] divides.
pub(super) const MAX_CELLS: i32 = 64;
/// The bits behind the point of columns between samples.
const FRACTION: u32 = 22;
const ONE: i32 = 1 << FRACTION;
/// Above the rounding of columns, and below the distance of a crossing that is no lattice point to the next one.
const ROUNDING: i32 = 1 << 13;

/// One over whole numbers, with [`FRACTION`] bits behind the point.
const INVERSES: [i32; MAX_CELLS as usize + 1] = {
    let mut inverses = [0; MAX_CELLS as usize + 1];
    let mut number = 1;
    while number <= MAX_CELLS {
        inverses[number as usize] = (ONE + number / 2) / number;
        number += 1;
    }
    inverses
};

/// A straight line from row to row: its column at row 0, and the columns from one row to the next.
#[derive(Clone, Copy)]
struct Side {
    start: i32,
    slope: i32,
}

impl Side {
    #[inline(always)]
    fn through(p: Point, q: Point) -> Self {
        let rows = q[1] - p[1];
        let slope = (q[0] - p[0]) * rows.signum() * INVERSES[rows.unsigned_abs() as usize];
        Self { start: (p[0] << FRACTION).wrapping_sub(slope.wrapping_mul(p[1])), slope }
    }

    /// Returns the column at a row between the ends of the side. Other rows and level sides have none.
    #[inline(always)]
    fn at(self, y: i32) -> i32 {
        self.start.wrapping_add(self.slope.wrapping_mul(y))
    }
}

/// The rows of lattice points in a triangle with corners counter-clockwise: row, first and last column. Points on the edges of
/// the triangle belong to it; samples on the edges of the square, from 0 to `last`, are left out.
pub(super) struct Rows {
    /// The next row, and the last one.
    y: i32,
    end: i32,
    /// The last row below the corner at which a side bends.
    bend: i32,
    west: [Side; 2],
    east: [Side; 2],
    last: i32,
}

impl Rows {
    #[inline(always)]
    pub fn new([a, b, c]: [Point; 3], last: i32) -> Self {
        // The lowest corner first.
        let [a, b, c] = if a[1] <= b[1] && a[1] <= c[1] {
            [a, b, c]
        } else if b[1] <= c[1] {
            [b, c, a]
        } else {
            [c, a, b]
        };
        let (right, left, top) = (Side::through(a, b), Side::through(a, c), Side::through(b, c));
        let bend = b[1].min(c[1]);
        // Above the lower one of `b` and `c` the side between them continues the one that ended there.
        let [west, east] = if b[1] <= c[1] { [[left, left], [right, top]] } else { [[left, top], [right, right]] };
        Self {
            y: a[1].max(1),
            end: b[1].max(c[1]).min(last - 1),
            bend: if bend == a[1] { -1 } else { bend },
            west,
            east,
            last,
        }
    }
}

impl Iterator for Rows {
    type Item = (i32, i32, i32);

    #[inline(always)]
    fn next(&mut self) -> Option<Self::Item> {
        while self.y <= self.end {
            let y = self.y;
            self.y += 1;
            let part = usize::from(y > self.bend);
            let from = ((self.west[part].at(y) + (ONE - 1 - ROUNDING)) >> FRACTION).max(1);
            let to = ((self.east[part].at(y) + ROUNDING) >> FRACTION).min(self.last - 1);
            if from <= to {
                return Some((y, from, to));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::triangulation::turn;
    use super::*;

    /// Every triangle of a small square, by its corners: the samples that are not outside of any edge.
    #[test]
    fn rows_have_all_samples_of_a_triangle() {
        let last = 64;
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % (last as u64 + 1)) as i32
        };
        for round in 0..3000 {
            // Small ones as well, and some with corners in the same row.
            let scale = [1, 4, 16][round % 3];
            let [a, b, mut c] = [0; 3].map(|_| [next() / scale, next() / scale]);
            if round % 5 == 0 {
                c[1] = a[1];
            }
            let corners = match turn(a, b, c) {
                0 => continue,
                1.. => [a, b, c],
                _ => [b, a, c],
            };
            let inside = |p: Point| (0..3).all(|k| turn(corners[k], corners[(k + 1) % 3], p) >= 0);
            let all = (1..last).flat_map(|y| (1..last).map(move |x| [x, y])).filter(|p| inside(*p));
            let rows = Rows::new(corners, last).flat_map(|(y, from, to)| (from..=to).map(move |x| [x, y]));
            assert!(all.eq(rows), "{corners:?}");
        }
    }
}
