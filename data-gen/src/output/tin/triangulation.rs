//! [`Triangulation`]: the Delaunay triangulation of lattice points in a square, point by point (Lawson 1977).

/// No neighbour: the edge lies on the border of the square.
const NONE: u16 = u16::MAX;

/// A point of the lattice: column and row.
pub(super) type Point = [i32; 2];

/// The edges of a triangle, from corner `k` to the next, are numbered `4 * triangle + k`. A triangle has four numbers in each
/// list, so that it is found by shifts.
type Four = [u16; 4];

/// Returns the number of an edge, or of the triangle that has it.
#[inline(always)]
fn edge(triangle: u16, k: u16) -> u16 {
    triangle << 2 | k
}

#[inline(always)]
fn triangle_of(edge: u16) -> u16 {
    edge >> 2
}

/// Returns the index of an edge in its triangle, and the indices of the next edge and of the one before.
#[inline(always)]
fn places(edge: u16) -> [usize; 3] {
    let at = edge & 3;
    // Two bits for each index.
    [at, 0b00_10_01 >> (2 * at) & 3, 0b01_00_10 >> (2 * at) & 3].map(usize::from)
}

/// Returns a point as a number, and the other way round.
#[inline(always)]
fn pack(point: Point) -> u16 {
    (point[0] | point[1] << 8) as u16
}

#[inline(always)]
fn point(packed: u16) -> Point {
    [packed & 0xff, packed >> 8].map(i32::from)
}

/// A Delaunay triangulation of a square with at most [`super::rows::MAX_CELLS`] cells along a side. Of the two diagonals of a
/// cell with four vertices it has the one from south-west to north-east, as the grid has. All arithmetic is exact.
pub(super) struct Triangulation {
    /// See [`pack`].
    points: Vec<u16>,
    /// The corners of each triangle, counter-clockwise; see [`pack`].
    corners: Vec<Four>,
    /// For each edge the one of the neighbour, in the other direction.
    twins: Vec<Four>,
    /// Triangles that changed since [`Self::take_changed`].
    changed: Vec<u16>,
    /// True for those triangles.
    is_changed: Vec<bool>,
    /// Triangles whose edge opposite to the newest point must be checked.
    open: Vec<u16>,
    /// A triangle near the newest point.
    near: u16,
}

impl Triangulation {
    /// Creates two triangles over the square from 0 to `last`.
    pub fn new(last: i32) -> Self {
        let [sw, se, ne, nw] = [[0, 0], [last, 0], [last, last], [0, last]].map(pack);
        Self {
            points: vec![sw, se, ne, nw],
            corners: vec![[sw, se, ne, 0], [sw, ne, nw, 0]],
            twins: vec![[NONE, NONE, edge(1, 0), NONE], [edge(0, 2), NONE, NONE, NONE]],
            changed: Vec::new(),
            is_changed: vec![false; 2],
            open: Vec::new(),
            near: 0,
        }
    }

    /// Returns the points, in the order in which they were inserted after the four corners.
    pub fn points(&self) -> impl ExactSizeIterator<Item = Point> {
        self.points.iter().map(|packed| point(*packed))
    }

    /// Returns the number of triangles.
    pub fn len(&self) -> usize {
        self.corners.len()
    }

    /// Returns the corners of a triangle.
    #[inline(always)]
    pub fn corners(&self, triangle: u16) -> [Point; 3] {
        let [a, b, c, _] = self.corners[usize::from(triangle)];
        [a, b, c].map(point)
    }

    /// Returns for each edge of a triangle true if it is its only triangle, or the one of the two with the lower number.
    pub fn owns_edges(&self, triangle: u16) -> [bool; 3] {
        self.neighbours(triangle).map(|neighbour| neighbour > triangle)
    }

    /// Returns for each edge of a triangle true if it lies on an edge of the square.
    #[inline(always)]
    pub fn outer_edges(&self, triangle: u16) -> [bool; 3] {
        self.neighbours(triangle).map(|neighbour| neighbour == triangle_of(NONE))
    }

    /// Returns the triangles at the edges of a triangle; that of [`NONE`] at an edge of the square.
    #[inline(always)]
    fn neighbours(&self, triangle: u16) -> [u16; 3] {
        let [first, second, third, _] = self.twins[usize::from(triangle)];
        [first, second, third].map(triangle_of)
    }

    /// Moves the numbers of the triangles that changed to `out`, each once.
    pub fn take_changed(&mut self, out: &mut Vec<u16>) {
        out.clear();
        out.append(&mut self.changed);
        out.iter().for_each(|triangle| self.is_changed[usize::from(*triangle)] = false);
    }

    /// Returns true if a triangle has changed since [`Self::take_changed`].
    pub fn is_changed(&self, triangle: u16) -> bool {
        self.is_changed[usize::from(triangle)]
    }

    /// Inserts a point of the square. A point that is already a vertex changes nothing.
    pub fn insert_anywhere(&mut self, point: Point) {
        let triangle = self.find(point, self.near);
        self.insert(point, triangle);
    }

    /// Inserts a point of a triangle. A point that is already a vertex changes nothing.
    pub fn insert(&mut self, point: Point, triangle: u16) {
        let [a, b, c] = self.corners(triangle);
        let own = pack(point);
        match [turn(a, b, point), turn(b, c, point), turn(c, a, point)].map(|turn| turn == 0) {
            [false, false, false] => self.split_inside(triangle, own),
            [true, false, false] => self.split_edge(edge(triangle, 0), own),
            [false, true, false] => self.split_edge(edge(triangle, 1), own),
            [false, false, true] => self.split_edge(edge(triangle, 2), own),
            // A corner lies on two edges.
            _ => return,
        }
        self.points.push(own);
        self.near = triangle;
        while let Some(triangle) = self.open.pop() {
            if !std::mem::replace(&mut self.is_changed[usize::from(triangle)], true) {
                self.changed.push(triangle);
            }
            self.flip_if_needed(triangle);
        }
    }

    /// Returns a triangle that contains the point, by walking towards it from another one.
    pub fn find(&self, point: Point, near: u16) -> u16 {
        let mut number = near;
        loop {
            let ([a, b, c], around) = (self.corners(number), &self.twins[usize::from(number)]);
            // Nothing of the square lies beyond an edge without a neighbour.
            number = triangle_of(if turn(a, b, point) < 0 {
                around[0]
            } else if turn(b, c, point) < 0 {
                around[1]
            } else if turn(c, a, point) < 0 {
                around[2]
            } else {
                return number;
            });
        }
    }

    fn add(&mut self, [a, b, c]: [u16; 3], [ab, bc, ca]: [u16; 3]) {
        self.corners.push([a, b, c, 0]);
        self.twins.push([ab, bc, ca, NONE]);
        self.is_changed.push(false);
    }

    #[inline(always)]
    fn set(&mut self, triangle: u16, [a, b, c]: [u16; 3], [ab, bc, ca]: [u16; 3]) {
        self.corners[usize::from(triangle)] = [a, b, c, 0];
        self.twins[usize::from(triangle)] = [ab, bc, ca, NONE];
    }

    /// Returns those triangles that are kept, each beside the one before where possible: the neighbour of which fewest neighbours
    /// are left. So indices take few bytes, and vertices are used again while they are in a GPU's cache.
    pub fn in_strips(&self, is_kept: impl Fn(u16) -> bool) -> Vec<u16> {
        /// The number of neighbours that are left, of a triangle that is not.
        const TAKEN: u8 = u8::MAX;
        let count = self.corners.len();
        let kept = (0..count as u16).map(|triangle| if is_kept(triangle) { 0 } else { TAKEN });
        // Beyond the last triangle is the one of edges of the square.
        let mut left: Vec<u8> = kept.chain([TAKEN]).collect();
        let around = |triangle: u16| self.neighbours(triangle).map(|other| usize::from(other).min(count));
        for triangle in 0..count as u16 {
            if left[usize::from(triangle)] != TAKEN {
                left[usize::from(triangle)] = around(triangle).map(|other| u8::from(left[other] != TAKEN)).iter().sum();
            }
        }
        let mut out = Vec::with_capacity(count);
        // Each triangle is put aside by its neighbours only, and the loop below writes up to three that it does not keep.
        let (mut aside, mut asides) = (vec![0; 3 * count + 3], 0);
        for start in 0..count {
            let mut next = start;
            loop {
                if left[next] == TAKEN {
                    if asides == 0 {
                        break;
                    }
                    asides -= 1;
                    next = usize::from(aside[asides]);
                    continue;
                }
                left[next] = TAKEN;
                out.push(next as u16);
                let others = around(next as u16);
                let mut best = (TAKEN, count);
                // Without branches, which a processor would not foresee.
                let found = others.map(|other| {
                    let is_left = left[other] != TAKEN;
                    left[other] -= u8::from(is_left);
                    best = if left[other] < best.0 { (left[other], other) } else { best };
                    is_left
                });
                for (other, is_left) in others.into_iter().zip(found) {
                    aside[asides] = other as u16;
                    asides += usize::from(is_left && other != best.1);
                }
                next = best.1;
            }
        }
        out
    }

    /// Tells the neighbour of an edge about it.
    #[inline(always)]
    fn link(&mut self, twin: u16, edge: u16) {
        // An edge of the square has no triangle on the other side.
        if let Some(twins) = self.twins.get_mut(usize::from(triangle_of(twin))) {
            twins[usize::from(twin & 3)] = edge;
        }
    }

    /// Splits a triangle into three at a point inside. In all new triangles the point is the last corner.
    fn split_inside(&mut self, first: u16, p: u16) {
        let ([a, b, c, _], [ab, bc, ca, _]) = (self.corners[usize::from(first)], self.twins[usize::from(first)]);
        let second = self.corners.len() as u16;
        let third = second + 1;
        self.set(first, [a, b, p], [ab, edge(second, 2), edge(third, 1)]);
        self.add([b, c, p], [bc, edge(third, 2), edge(first, 1)]);
        self.add([c, a, p], [ca, edge(first, 2), edge(second, 1)]);
        self.link(bc, edge(second, 0));
        self.link(ca, edge(third, 0));
        self.open.extend([first, second, third]);
    }

    /// Splits the triangles at an edge, one or two, at a point on it.
    fn split_edge(&mut self, split: u16, p: u16) {
        let (first, second) = (triangle_of(split), self.corners.len() as u16);
        let of = |list: &[Four], edge: u16| places(edge).map(|k| list[usize::from(triangle_of(edge))][k]);
        let ([a, b, c], [twin, bc, ca]) = (of(&self.corners, split), of(&self.twins, split));
        self.set(first, [c, a, p], [ca, NONE, edge(second, 1)]);
        self.add([b, c, p], [bc, edge(first, 2), NONE]);
        self.link(ca, edge(first, 0));
        self.link(bc, edge(second, 0));
        self.open.extend([first, second]);
        if twin == NONE {
            return;
        }
        let (third, fourth) = (triangle_of(twin), second + 1);
        let ([_, _, d], [_, ad, db]) = (of(&self.corners, twin), of(&self.twins, twin));
        self.set(third, [a, d, p], [ad, edge(fourth, 2), edge(first, 1)]);
        self.add([d, b, p], [db, edge(second, 2), edge(third, 1)]);
        self.link(ad, edge(third, 0));
        self.link(db, edge(fourth, 0));
        self.link(edge(first, 1), edge(third, 2));
        self.link(edge(second, 2), edge(fourth, 1));
        self.open.extend([third, fourth]);
    }

    /// Flips the first edge of a triangle if the other diagonal is that of the Delaunay triangulation. The newest point is the
    /// last corner.
    #[inline(always)]
    fn flip_if_needed(&mut self, triangle: u16) {
        let [twin, bp, pa, _] = self.twins[usize::from(triangle)];
        let across = triangle_of(twin);
        let Some(corners) = self.corners.get(usize::from(across)) else { return };
        let [_, next, last] = places(twin);
        let q = corners[last];
        let [a, b, p, _] = self.corners[usize::from(triangle)];
        if !is_flipped([a, b, p, q].map(point)) {
            return;
        }
        let around = &self.twins[usize::from(across)];
        let (aq, qb) = (around[next], around[last]);
        self.set(triangle, [a, q, p], [aq, edge(across, 2), pa]);
        self.set(across, [q, b, p], [qb, bp, edge(triangle, 1)]);
        self.link(aq, edge(triangle, 0));
        self.link(qb, edge(across, 0));
        self.link(bp, edge(across, 1));
        self.open.extend([triangle, across]);
    }
}

/// Returns true if the edge from `a` to `b`, with `p` on its left and `q` on its right, must become one from `p` to `q`.
#[inline(always)]
fn is_flipped([a, b, p, q]: [Point; 4]) -> bool {
    let inside = in_circle(a, b, p, q);
    let is_cell = || (a[0] - b[0]) * (a[1] - b[1]) == -1 && (p[0] - q[0]) * (p[1] - q[1]) == 1;
    inside > 0 || (inside == 0 && is_cell())
}

/// Returns twice the area of a triangle, positive if it is counter-clockwise.
pub(super) fn turn(a: Point, b: Point, c: Point) -> i32 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Returns a positive number if `d` lies inside of the circle through three points that are counter-clockwise, 0 on it.
fn in_circle(a: Point, b: Point, c: Point, d: Point) -> i32 {
    let [[ax, ay, aa], [bx, by, bb], [cx, cy, cc]] = [a, b, c].map(|p| {
        let (x, y) = (p[0] - d[0], p[1] - d[1]);
        // Squares of distances in the square have 14 bits, and the products below 28.
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
            let area: i32 = (0..net.len())
                .map(|t| {
                    let [a, b, c] = net.corners(t as u16);
                    assert!(turn(a, b, c) > 0);
                    turn(a, b, c)
                })
                .sum();
            assert_eq!(area, 2 * 16 * 16);
        }
        for t in 0..net.len() as u16 {
            let [a, b, c] = net.corners(t);
            for (k, twin) in net.twins[usize::from(t)][..3].iter().enumerate() {
                let (from, to) = (net.corners(t)[k], net.corners(t)[(k + 1) % 3]);
                if *twin == NONE {
                    assert!((0..2).any(|x| from[x] == to[x] && (from[x] == 0 || from[x] == 16)));
                } else {
                    let (other, [at, next, _]) = (net.corners(triangle_of(*twin)), places(*twin));
                    assert_eq!([other[at], other[next]], [to, from]);
                }
            }
            assert!(net.points().all(|d| in_circle(a, b, c, d) <= 0), "a point inside of a circle");
        }
    }

    #[test]
    fn strips_have_each_kept_triangle_once() {
        let mut net = Triangulation::new(16);
        (0..90).for_each(|k| net.insert_anywhere([k * 7 % 17, k * k % 17]));
        let is_kept = |triangle: u16| !triangle.is_multiple_of(5);
        let strips = net.in_strips(is_kept);
        let mut sorted = strips.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq((0..net.len() as u16).filter(|t| is_kept(*t))));
        let all = net.in_strips(|_| true);
        let beside = all.windows(2).filter(|two| net.neighbours(two[0]).contains(&two[1])).count();
        assert!(10 * beside > 7 * all.len(), "{beside} of {}", all.len());
    }

    #[test]
    fn whole_cells_have_the_diagonal_of_the_grid() {
        // In several orders.
        for step in [1, 7, 11, 13] {
            let mut net = Triangulation::new(4);
            (0..25).map(|k| k * step % 25).for_each(|k| net.insert_anywhere([k % 5, k / 5]));
            assert_eq!(net.len(), 32);
            for t in 0..32 {
                let [a, b, c] = net.corners(t);
                assert!([(a, b), (b, c), (c, a)].iter().all(|(p, q)| (p[0] - q[0]) * (p[1] - q[1]) >= 0));
            }
        }
    }
}
