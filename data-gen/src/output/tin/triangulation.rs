//! [`Triangulation`]: the Delaunay triangulation of lattice points in a square, point by point (Lawson 1977).

/// No neighbour: the edge lies on the border of the square.
const NONE: u32 = u32::MAX;

/// A point of the lattice: column and row.
pub(super) type Point = [i32; 2];

/// A Delaunay triangulation of a square. Of the two diagonals of a cell with four vertices it has the one from south-west to
/// north-east, as the grid has. All arithmetic is exact.
pub(super) struct Triangulation {
    points: Vec<Point>,
    /// Vertices of each triangle, counter-clockwise.
    corners: Vec<[u32; 3]>,
    /// For each triangle the one across the edge from corner `k` to the next.
    neighbours: Vec<[u32; 3]>,
    /// Triangles that changed since [`Self::take_changed`].
    changed: Vec<u32>,
    /// True for those triangles.
    is_changed: Vec<bool>,
    /// Triangles whose edge opposite to the newest point must be checked.
    open: Vec<u32>,
    /// A triangle near the newest point.
    near: u32,
}

impl Triangulation {
    /// Creates two triangles over the square from 0 to `last`.
    pub fn new(last: i32) -> Self {
        Self {
            points: vec![[0, 0], [last, 0], [last, last], [0, last]],
            corners: vec![[0, 1, 2], [0, 2, 3]],
            neighbours: vec![[NONE, NONE, 1], [0, NONE, NONE]],
            changed: Vec::new(),
            is_changed: vec![false; 2],
            open: Vec::new(),
            near: 0,
        }
    }

    /// Returns the points, in the order in which they were inserted after the four corners.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Returns the vertices of all triangles.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.corners
    }

    /// Returns the corners of a triangle.
    pub fn corners(&self, triangle: u32) -> [Point; 3] {
        self.corners[triangle as usize].map(|vertex| self.points[vertex as usize])
    }

    /// Returns for each edge of a triangle true if it is its only triangle, or the one of the two with the lower number.
    pub fn owns_edges(&self, triangle: u32) -> [bool; 3] {
        self.neighbours[triangle as usize].map(|neighbour| neighbour == NONE || neighbour > triangle)
    }

    /// Returns for each edge of a triangle true if it lies on an edge of the square.
    pub fn outer_edges(&self, triangle: u32) -> [bool; 3] {
        self.neighbours[triangle as usize].map(|neighbour| neighbour == NONE)
    }

    /// Moves the numbers of the triangles that changed to `out`, each once.
    pub fn take_changed(&mut self, out: &mut Vec<u32>) {
        out.clear();
        out.append(&mut self.changed);
        out.iter().for_each(|triangle| self.is_changed[*triangle as usize] = false);
    }

    /// Returns true if a triangle has changed since [`Self::take_changed`].
    pub fn is_changed(&self, triangle: u32) -> bool {
        self.is_changed[triangle as usize]
    }

    /// Inserts a point of the square. A point that is already a vertex changes nothing.
    pub fn insert_anywhere(&mut self, point: Point) {
        self.insert(point, self.near);
    }

    /// Inserts a point as [`Self::insert_anywhere`] does. It is quick if the triangle `near` is near the point.
    pub fn insert(&mut self, point: Point, near: u32) {
        let triangle = self.find(point, near);
        let corners = self.corners(triangle);
        if corners.contains(&point) {
            return;
        }
        let vertex = self.points.len() as u32;
        self.points.push(point);
        let on_edge = (0..3).find(|k| turn(corners[*k], corners[(k + 1) % 3], point) == 0);
        match on_edge {
            None => self.split_inside(triangle, vertex),
            Some(edge) => self.split_edge(triangle, edge, vertex),
        }
        self.near = triangle;
        while let Some(triangle) = self.open.pop() {
            if !std::mem::replace(&mut self.is_changed[triangle as usize], true) {
                self.changed.push(triangle);
            }
            self.flip_if_needed(triangle);
        }
    }

    /// Returns a triangle that contains the point, by walking towards it from another one.
    pub fn find(&self, point: Point, near: u32) -> u32 {
        let mut triangle = near;
        'walk: loop {
            let corners = self.corners(triangle);
            for k in 0..3 {
                let next = self.neighbours[triangle as usize][k];
                if next != NONE && turn(corners[k], corners[(k + 1) % 3], point) < 0 {
                    triangle = next;
                    continue 'walk;
                }
            }
            return triangle;
        }
    }

    fn add(&mut self, corners: [u32; 3], neighbours: [u32; 3]) -> u32 {
        self.corners.push(corners);
        self.neighbours.push(neighbours);
        self.is_changed.push(false);
        (self.corners.len() - 1) as u32
    }

    fn set(&mut self, triangle: u32, corners: [u32; 3], neighbours: [u32; 3]) {
        self.corners[triangle as usize] = corners;
        self.neighbours[triangle as usize] = neighbours;
    }

    /// Returns those triangles that are kept, each beside the one before where possible: the neighbour of which fewest neighbours
    /// are left. So indices take few bytes, and vertices are used again while they are in a GPU's cache.
    pub fn in_strips(&self, is_kept: impl Fn(u32) -> bool) -> Vec<u32> {
        let count = self.corners.len() as u32;
        let mut is_left: Vec<bool> = (0..count).map(is_kept).collect();
        let is_open = |is_left: &[bool], triangle: u32| triangle != NONE && is_left[triangle as usize];
        let (mut out, mut beside) = (Vec::with_capacity(count as usize), Vec::new());
        for start in 0..count {
            beside.push(start);
            while let Some(mut triangle) = beside.pop() {
                while is_open(&is_left, triangle) {
                    is_left[triangle as usize] = false;
                    out.push(triangle);
                    let (mut next, mut fewest) = (NONE, usize::MAX);
                    for neighbour in self.neighbours[triangle as usize] {
                        if !is_open(&is_left, neighbour) {
                            continue;
                        }
                        let around = self.neighbours[neighbour as usize];
                        let left = around.iter().filter(|other| is_open(&is_left, **other)).count();
                        let other = if left < fewest { std::mem::replace(&mut next, neighbour) } else { neighbour };
                        fewest = fewest.min(left);
                        if other != NONE {
                            beside.push(other);
                        }
                    }
                    triangle = next;
                }
            }
        }
        out
    }

    /// Tells a triangle that its neighbour `old` is now `new`.
    fn relink(&mut self, triangle: u32, old: u32, new: u32) {
        if triangle != NONE
            && let Some(link) = self.neighbours[triangle as usize].iter_mut().find(|link| **link == old)
        {
            *link = new;
        }
    }

    /// Splits a triangle into three at a point inside. In all new triangles the point is the last corner.
    fn split_inside(&mut self, triangle: u32, p: u32) {
        let ([a, b, c], [ab, bc, ca]) = (self.corners[triangle as usize], self.neighbours[triangle as usize]);
        let second = self.add([b, c, p], [bc, NONE, triangle]);
        let third = self.add([c, a, p], [ca, triangle, second]);
        self.neighbours[second as usize][1] = third;
        self.set(triangle, [a, b, p], [ab, second, third]);
        self.relink(bc, triangle, second);
        self.relink(ca, triangle, third);
        self.open.extend([triangle, second, third]);
    }

    /// Splits the triangles at an edge, one or two, at a point on it.
    fn split_edge(&mut self, triangle: u32, edge: usize, p: u32) {
        let rotated = |of: [u32; 3], by: usize| [of[by], of[(by + 1) % 3], of[(by + 2) % 3]];
        let [a, b, c] = rotated(self.corners[triangle as usize], edge);
        let [across, bc, ca] = rotated(self.neighbours[triangle as usize], edge);
        let second = self.add([b, c, p], [bc, triangle, NONE]);
        self.set(triangle, [c, a, p], [ca, NONE, second]);
        self.relink(bc, triangle, second);
        self.open.extend([triangle, second]);
        if across == NONE {
            return;
        }
        let at = self.edge_towards(across, triangle);
        let [_, _, d] = rotated(self.corners[across as usize], at);
        let [_, ad, db] = rotated(self.neighbours[across as usize], at);
        let fourth = self.add([d, b, p], [db, second, across]);
        self.set(across, [a, d, p], [ad, fourth, triangle]);
        self.relink(db, across, fourth);
        self.neighbours[triangle as usize][1] = across;
        self.neighbours[second as usize][2] = fourth;
        self.open.extend([across, fourth]);
    }

    /// Returns the edge of a triangle at which its neighbour `towards` lies.
    fn edge_towards(&self, triangle: u32, towards: u32) -> usize {
        // Neighbours know each other.
        let [first, second, _] = self.neighbours[triangle as usize];
        if first == towards {
            return 0;
        }
        if second == towards { 1 } else { 2 }
    }

    /// Flips the first edge of a triangle if the other diagonal is that of the Delaunay triangulation. The newest point is the
    /// last corner.
    fn flip_if_needed(&mut self, triangle: u32) {
        let across = self.neighbours[triangle as usize][0];
        if across == NONE {
            return;
        }
        let [a, b, p] = self.corners[triangle as usize];
        let at = self.edge_towards(across, triangle);
        let q = self.corners[across as usize][(at + 2) % 3];
        let [pa, pb, pp, pq] = [a, b, p, q].map(|vertex| self.points[vertex as usize]);
        let inside = in_circle(pa, pb, pp, pq);
        let is_cell = || (pa[0] - pb[0]) * (pa[1] - pb[1]) == -1 && (pp[0] - pq[0]) * (pp[1] - pq[1]) == 1;
        if inside < 0 || (inside == 0 && !is_cell()) {
            return;
        }
        let [aq, qb] = [1, 2].map(|k| self.neighbours[across as usize][(at + k) % 3]);
        let [_, bp, pa] = self.neighbours[triangle as usize];
        self.set(triangle, [a, q, p], [aq, across, pa]);
        self.set(across, [q, b, p], [qb, bp, triangle]);
        self.relink(aq, across, triangle);
        self.relink(bp, triangle, across);
        self.open.extend([triangle, across]);
    }
}

/// Returns twice the area of a triangle, positive if it is counter-clockwise.
pub(super) fn turn(a: Point, b: Point, c: Point) -> i32 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

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

/// The rows of lattice points in a triangle with corners counter-clockwise, its edges included, without the samples on the edges
/// of the square from 0 to `last`: the row, the first and the last column.
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

/// Returns a positive number if `d` lies inside of the circle through three points that are counter-clockwise, 0 on it.
fn in_circle(a: Point, b: Point, c: Point, d: Point) -> i64 {
    let [[ax, ay, aa], [bx, by, bb], [cx, cy, cc]] = [a, b, c].map(|p| {
        let (x, y) = (i64::from(p[0] - d[0]), i64::from(p[1] - d[1]));
        [x, y, x * x + y * y]
    });
    aa * (bx * cy - by * cx) - bb * (ax * cy - ay * cx) + cc * (ax * by - ay * bx)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_points_give_a_delaunay_triangulation_of_the_square() {
        let mut state = 7u64;
        let mut next = |below: i32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % below as u64) as i32
        };
        let mut net = Triangulation::new(16);
        for _ in 0..150 {
            // Also points on the border, and some twice.
            net.insert_anywhere([next(17), next(17)]);
            let area: i32 = (0..net.triangles().len())
                .map(|t| {
                    let [a, b, c] = net.corners(t as u32);
                    assert!(turn(a, b, c) > 0);
                    turn(a, b, c)
                })
                .sum();
            assert_eq!(area, 2 * 16 * 16);
        }
        for t in 0..net.triangles().len() as u32 {
            let [a, b, c] = net.corners(t);
            for (k, neighbour) in net.neighbours[t as usize].iter().enumerate() {
                let (from, to) = (net.corners(t)[k], net.corners(t)[(k + 1) % 3]);
                if *neighbour == NONE {
                    assert!((0..2).any(|x| from[x] == to[x] && (from[x] == 0 || from[x] == 16)));
                } else {
                    let other = net.corners(*neighbour);
                    let at = net.edge_towards(*neighbour, t);
                    assert_eq!([other[at], other[(at + 1) % 3]], [to, from]);
                }
            }
            assert!(net.points().iter().all(|d| in_circle(a, b, c, *d) <= 0), "a point inside of a circle");
        }
    }

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

    #[test]
    fn strips_have_each_kept_triangle_once() {
        let mut net = Triangulation::new(16);
        (0..90).for_each(|k| net.insert_anywhere([k * 7 % 17, k * k % 17]));
        let is_kept = |triangle: u32| !triangle.is_multiple_of(5);
        let strips = net.in_strips(is_kept);
        let mut sorted = strips.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq((0..net.triangles().len() as u32).filter(|t| is_kept(*t))));
        let all = net.in_strips(|_| true);
        let beside = all.windows(2).filter(|two| net.neighbours[two[0] as usize].contains(&two[1])).count();
        assert!(10 * beside > 7 * all.len(), "{beside} of {}", all.len());
    }

    #[test]
    fn whole_cells_have_the_diagonal_of_the_grid() {
        // In several orders.
        for step in [1, 7, 11, 13] {
            let mut net = Triangulation::new(4);
            (0..25).map(|k| k * step % 25).for_each(|k| net.insert_anywhere([k % 5, k / 5]));
            assert_eq!(net.triangles().len(), 32);
            for t in 0..32 {
                let [a, b, c] = net.corners(t);
                assert!([(a, b), (b, c), (c, a)].iter().all(|(p, q)| (p[0] - q[0]) * (p[1] - q[1]) >= 0));
            }
        }
    }
}
