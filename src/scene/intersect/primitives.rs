//! The corners of a drawable's primitives, as they are drawn: from its payload, or from the compact copy that a
//! [`super::KdTree`] keeps after the payload was uploaded.

use std::ops::Range;

use glam::{DVec3, Vec3};

use crate::math::Ray;
use crate::scene::geometry::{Geometry, HeightTile, Mesh, Topology};

/// The corners of a triangle, a segment or a point; the last one is repeated if there are fewer than three.
pub(crate) type Corners = [DVec3; 3];

/// A primitive of a drawable, in the drawable's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Primitive {
    pub number: u32,
    pub vertices: [u32; 3],
    pub corners: Corners,
    /// The number of distinct corners: 3, 2 or 1.
    pub count: usize,
    /// The normal, not of unit length; zero for segments and points.
    pub normal: DVec3,
}

/// Returns the number of corners of a primitive.
pub(crate) fn corner_count(topology: Topology) -> usize {
    match topology {
        // The triangles of squares have no area, so that lines miss them as they miss points.
        Topology::Triangles | Topology::Squares => 3,
        Topology::Lines => 2,
        Topology::Points => 1,
    }
}

/// The positions of a mesh, and its indices in the order of the tree's leaves.
#[derive(Debug)]
pub(super) struct MeshCorners {
    pub positions: Box<[[f32; 3]]>,
    pub indices: Indices,
    /// The index of the primitive in the drawable, by its index in the tree.
    pub order: Indices,
    /// The number of corners of each primitive.
    pub corners: usize,
}

/// Indices in 16 bits if possible.
#[derive(Debug)]
pub(super) enum Indices {
    Small(Box<[u16]>),
    Large(Box<[u32]>),
}

impl Indices {
    /// Stores indices that are all below `limit`.
    pub fn new(indices: impl Iterator<Item = u32>, limit: usize) -> Self {
        if limit <= 1 << 16 { Self::Small(indices.map(|i| i as u16).collect()) } else { Self::Large(indices.collect()) }
    }

    #[inline(always)]
    pub fn at(&self, i: usize) -> u32 {
        match self {
            Self::Small(list) => u32::from(list[i]),
            Self::Large(list) => list[i],
        }
    }

    pub fn size_bytes(&self) -> usize {
        match self {
            Self::Small(list) => 2 * list.len(),
            Self::Large(list) => 4 * list.len(),
        }
    }
}

impl MeshCorners {
    #[inline(always)]
    pub fn vertices(&self, index: usize) -> [u32; 3] {
        let at = |n: usize| self.indices.at(index * self.corners + n.min(self.corners - 1));
        [at(0), at(1), at(2)]
    }

    #[inline(always)]
    pub fn of(&self, index: usize) -> Corners {
        self.vertices(index).map(|v| Vec3::from_array(self.positions[v as usize]).as_dvec3())
    }
}

/// Heights, stored as 16-bit steps of a power of two if all are multiples of it, as those of `data-gen` are.
#[derive(Debug)]
enum Heights {
    Steps { lowest_m: f64, step_m: f64, steps: Box<[u16]> },
    Metres(Box<[f32]>),
}

impl Heights {
    /// Stores heights without loss: if they are not on 65,536 steps, they stay f32.
    fn new(heights_m: Vec<f32>) -> Self {
        let lowest = heights_m.iter().copied().fold(f32::INFINITY, f32::min);
        let highest = heights_m.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let lowest_m = f64::from(lowest);
        let rise_m = f64::from(highest) - lowest_m;
        let mut step_m = 1.0 / 1024.0;
        while rise_m / step_m > 65_535.0 {
            step_m *= 2.0;
        }
        let in_steps = |h: &f32| (f64::from(*h) - lowest_m) / step_m;
        if heights_m.iter().all(|h| in_steps(h).fract() == 0.0) {
            Self::Steps { lowest_m, step_m, steps: heights_m.iter().map(|h| in_steps(h) as u16).collect() }
        } else {
            Self::Metres(heights_m.into())
        }
    }

    #[inline(always)]
    fn at(&self, i: usize) -> f64 {
        match self {
            Self::Steps { lowest_m, step_m, steps } => lowest_m + step_m * f64::from(steps[i]),
            Self::Metres(list) => f64::from(list[i]),
        }
    }
}

/// A view along a line, in which the line itself is a point.
pub(super) struct Sight {
    origin: DVec3,
    /// Unit vectors perpendicular to the line and to each other.
    right: DVec3,
    up: DVec3,
    /// Points closer to the line count as on both sides of it, metres.
    room_m: f64,
}

impl Sight {
    /// Creates the sight along a ray. `up` should be the direction in which the surface mostly faces, which separates triangles
    /// above and below the line best.
    pub fn new(ray: &Ray, up: DVec3, room_m: f64) -> Self {
        let along = ray.direction.normalize_or(DVec3::Z);
        let right = along.cross(up).try_normalize().unwrap_or_else(|| along.any_orthonormal_vector());
        Self { origin: ray.origin, right, up: right.cross(along), room_m }
    }

    /// Returns the sides of the line that a point is on, a bit for each: right, left, above, below.
    #[inline(always)]
    fn sides(&self, point: DVec3) -> u8 {
        let from_line = point - self.origin;
        let (x, y) = (self.right.dot(from_line), self.up.dot(from_line));
        u8::from(x > self.room_m)
            | u8::from(x < -self.room_m) << 1
            | u8::from(y > self.room_m) << 2
            | u8::from(y < -self.room_m) << 3
    }
}

/// The maximum number of corners along a side of a leaf.
const MAX_CORNERS: usize = 5;
/// The maximum number of triangles in a leaf.
const MAX_TRIANGLES: usize = 2 * (MAX_CORNERS - 1) * (MAX_CORNERS - 1);

/// The grid of a [`HeightTile`] without its border, two triangles per cell; triangles are ordered by cells along a Z-order
/// curve.
#[derive(Debug)]
pub(super) struct HeightCorners {
    side: usize,
    p0_m: f64,
    rows: Box<[[f32; 4]]>,
    columns: Box<[[f32; 2]]>,
    heights: Heights,
}

impl HeightCorners {
    /// Copies the heights of a tile; `None` if its tables do not fit together, in which case it is not drawn either.
    pub fn new(tile: &HeightTile) -> Option<Self> {
        let side = tile.side as usize;
        let fits = (3..=257).contains(&side)
            && (side - 1).is_power_of_two()
            && tile.rows.len() == side
            && tile.columns.len() == side
            && tile.heights.len() == (side + 2) * (side + 2)
            && tile.heights.iter().all(|h| h.is_finite());
        let inner = |j: usize| tile.heights.get((j + 1) * (side + 2) + 1..(j + 1) * (side + 2) + 1 + side);
        fits.then(|| Self {
            side,
            p0_m: f64::from(tile.p0_m),
            rows: tile.rows.clone().into(),
            columns: tile.columns.clone().into(),
            heights: Heights::new((0..side).filter_map(inner).flatten().copied().collect()),
        })
    }

    pub fn count(&self) -> usize {
        2 * (self.side - 1) * (self.side - 1)
    }

    /// Returns column, row and triangle of the cell: 0 is the south-eastern one.
    fn cell(index: usize) -> (usize, usize, usize) {
        let code = (index / 2) as u32;
        (even_bits(code), even_bits(code >> 1), index % 2)
    }

    /// Returns the index of a triangle in the tile: two per cell, row by row from the south-west.
    pub fn primitive(&self, index: usize) -> u32 {
        let (i, j, upper) = Self::cell(index);
        (2 * (j * (self.side - 1) + i) + upper) as u32
    }

    /// Returns the corners of a triangle as indices of grid points, row by row from the south-west.
    pub fn vertices(&self, index: usize) -> [u32; 3] {
        let (i, j, upper) = Self::cell(index);
        let at = |i: usize, j: usize| (j * self.side + i) as u32;
        if upper == 0 { [at(i, j), at(i + 1, j), at(i + 1, j + 1)] } else { [at(i, j), at(i + 1, j + 1), at(i, j + 1)] }
    }

    /// Returns a grid point by the formula of [`HeightTile`].
    #[inline(always)]
    fn vertex(&self, i: usize, j: usize) -> DVec3 {
        let [dp, dz, cos, sin] = self.rows[j].map(f64::from);
        let [column_sin, one_minus_cos] = self.columns[i].map(f64::from);
        let height_m = self.heights.at(j * self.side + i);
        let out = dp + height_m * cos;
        let across = self.p0_m + out;
        DVec3::new(across * column_sin, out - across * one_minus_cos, dz + height_m * sin)
    }

    #[inline(always)]
    pub fn of(&self, index: usize) -> Corners {
        let (i, j, upper) = Self::cell(index);
        let (a, c) = (self.vertex(i, j), self.vertex(i + 1, j + 1));
        if upper == 0 { [a, self.vertex(i + 1, j), c] } else { [a, c, self.vertex(i, j + 1)] }
    }

    /// Visits the triangles of a leaf that a line may meet, in order. Triangles whose corners are all on one side of it are
    /// left out. Each corner is computed once.
    #[inline(always)]
    pub fn along(&self, leaf: Range<usize>, sight: &Sight, mut visit: impl FnMut(usize, &Corners)) {
        let (i, j, _) = Self::cell(leaf.start);
        // A leaf has 4 x 4 cells, or 2 x 2 in the smallest tile.
        let side = if leaf.len() < MAX_TRIANGLES { 3 } else { MAX_CORNERS };
        let mut corners = [[DVec3::ZERO; MAX_CORNERS]; MAX_CORNERS];
        let mut sides = [[0; MAX_CORNERS]; MAX_CORNERS];
        let mut common = u8::MAX;
        for row in 0..side {
            for column in 0..side {
                let corner = self.vertex(i + column, j + row);
                (corners[row][column], sides[row][column]) = (corner, sight.sides(corner));
                common &= sides[row][column];
            }
        }
        if common != 0 {
            return;
        }
        for index in leaf.step_by(2) {
            let (i, j, _) = Self::cell(index % MAX_TRIANGLES);
            let across = sides[j][i] & sides[j + 1][i + 1];
            if across & sides[j][i + 1] == 0 {
                visit(index, &[corners[j][i], corners[j][i + 1], corners[j + 1][i + 1]]);
            }
            if across & sides[j + 1][i] == 0 {
                visit(index + 1, &[corners[j][i], corners[j + 1][i + 1], corners[j + 1][i]]);
            }
        }
    }

    /// Returns a triangle as it is drawn, with an upward normal: the tile's frame is left-handed.
    pub fn triangle(&self, index: usize) -> Primitive {
        let corners = self.of(index);
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a);
        let normal = if normal.dot(self.up(index)) < 0.0 { -normal } else { normal };
        Primitive { number: self.primitive(index), vertices: self.vertices(index), corners, count: 3, normal }
    }

    /// Returns the direction away from the ground at the cell of a triangle.
    pub fn up(&self, index: usize) -> DVec3 {
        let (i, j, _) = Self::cell(index);
        let [_, _, cos, sin] = self.rows[j].map(f64::from);
        let [column_sin, one_minus_cos] = self.columns[i].map(f64::from);
        DVec3::new(cos * column_sin, cos * (1.0 - one_minus_cos), sin)
    }

    pub fn size_bytes(&self) -> usize {
        let heights = match &self.heights {
            Heights::Steps { steps, .. } => 2 * steps.len(),
            Heights::Metres(list) => 4 * list.len(),
        };
        heights + self.rows.len() * 16 + self.columns.len() * 8
    }
}

/// Packs the bits 0, 2, 4, ...
fn even_bits(code: u32) -> usize {
    let mut x = code & 0x5555_5555;
    x = (x | (x >> 1)) & 0x3333_3333;
    x = (x | (x >> 2)) & 0x0f0f_0f0f;
    x = (x | (x >> 4)) & 0x00ff_00ff;
    x = (x | (x >> 8)) & 0x0000_ffff;
    x as usize
}

/// Returns index, vertices and corners of the primitives of a mesh that have valid corners.
pub(crate) fn mesh_primitives(mesh: &Mesh) -> impl Iterator<Item = (u32, [u32; 3], Corners)> + '_ {
    let count = corner_count(mesh.topology);
    mesh.indices.chunks_exact(count).enumerate().filter_map(move |(number, list)| {
        let vertices = [0, 1, 2].map(|n: usize| list[n.min(count - 1)]);
        let corner = |v: u32| Some(Vec3::from_array(mesh.vertices.get(v as usize)?.position)).filter(|p| p.is_finite());
        let [a, b, c] = vertices.map(corner);
        Some((number as u32, vertices, [a?, b?, c?].map(|p| p.as_dvec3())))
    })
}

/// Returns the number of corners of a geometry's primitives.
pub(crate) fn corners_of(geometry: &Geometry) -> usize {
    match geometry {
        Geometry::Mesh(mesh) => corner_count(mesh.topology),
        Geometry::Height(_) | Geometry::Splats(_) | Geometry::Custom(_) => 3,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::super::kd_tree::{KdTree, meet};
    use super::*;
    use crate::math::Aabb;

    #[test]
    fn the_curve_visits_every_cell_once() {
        let mut seen: Vec<_> = (0..2 * 64).map(HeightCorners::cell).collect();
        assert!(seen.iter().take(8).all(|(i, j, _)| *i < 2 && *j < 2), "blocks first");
        seen.sort_unstable();
        let all: Vec<_> = (0..8).flat_map(|i| (0..8).flat_map(move |j| [(i, j, 0), (i, j, 1)])).collect();
        assert_eq!(seen, all);
    }

    proptest! {
        #[test]
        fn lines_along_the_ground_match_a_brute_force_search(
            level in 1u32..5,
            // The ends of the line are between the lowest and the highest ground.
            steps in prop::collection::vec(0u16..300, 19 * 19),
            from in [-10f64..10.0, -10f64..10.0, 0f64..2.0],
            to in [-10f64..10.0, -10f64..10.0, 0f64..2.0],
        ) {
            let side = (1 << level) + 1;
            let at = |k: u32| 20.0 * k as f32 / (side - 1) as f32 - 10.0;
            let tile = HeightTile {
                side,
                rows: (0..side).map(|j| [-at(j), 0.0, 0.0, 1.0]).collect(),
                columns: (0..side).map(|i| [at(i) / 1e12, 0.0]).collect(),
                heights: steps.iter().take(((side + 2) * (side + 2)) as usize).map(|h| f32::from(*h) / 128.0).collect(),
                p0_m: 1e12,
                level: 0,
                coarser_errors_m: Vec::new(),
                skirt_m: 0.0,
                cell_m: [1.0; 2],
                texture: None,
                bounds: Aabb { min: DVec3::splat(-10.0), max: DVec3::splat(10.0) },
            };
            let corners = HeightCorners::new(&tile).unwrap();
            let tree = KdTree::build(&Geometry::Height(Arc::new(tile))).unwrap();
            let ray = Ray::segment(DVec3::from_array(from), DVec3::from_array(to));
            let triangles = (0..corners.count()).map(|index| corners.triangle(index));
            let mut expected: Vec<_> = triangles
                .filter_map(|t| meet(&ray, &t.corners).map(|(ratio, ..)| (t.number, ratio)))
                .filter(|(_, ratio)| (0.0..=1.0).contains(ratio))
                .collect();
            let mut found = Vec::new();
            tree.intersect_line(&ray, |hit| {
                found.push((hit.primitive, hit.ratio));
                f64::INFINITY
            });
            expected.sort_by_key(|hit| hit.0);
            found.sort_by_key(|hit| hit.0);
            prop_assert_eq!(found.len(), expected.len());
            for (a, b) in found.iter().zip(&expected) {
                prop_assert!(a.0 == b.0 && (a.1 - b.1).abs() < 1e-9, "{:?} {:?}", a, b);
            }
        }
    }

    #[test]
    fn heights_are_stored_without_loss() {
        let on_steps: Vec<f32> = (0..25).map(|i| 1234.5 + (i * i) as f32 / 128.0).collect();
        let off_steps: Vec<f32> = (0..25).map(|i| (i as f32).sin() * 1e3).collect();
        for (given, small) in [(on_steps, true), (off_steps, false), (vec![7.0; 25], true)] {
            let kept = Heights::new(given.clone());
            assert_eq!(matches!(kept, Heights::Steps { .. }), small);
            for (i, h) in given.iter().enumerate() {
                assert_eq!(kept.at(i), f64::from(*h));
            }
        }
    }
}
