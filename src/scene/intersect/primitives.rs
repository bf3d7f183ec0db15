//! The corners of a drawable's primitives, as they are drawn: from its payload, or from the little that a
//! [`super::KdTree`] keeps of it once the payload went to the GPU.

use std::ops::Range;

use glam::{DVec3, Vec3};

use crate::math::Ray;
use crate::scene::geometry::{Geometry, HeightTile, Mesh, Topology};

/// Corners of a triangle, a segment or a point; the last ones repeat where there are fewer than three.
pub(crate) type Corners = [DVec3; 3];

/// A primitive of a drawable, in the drawable's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Primitive {
    pub number: u32,
    pub vertices: [u32; 3],
    pub corners: Corners,
    /// How many of the corners are its own: 3, 2 or 1.
    pub count: usize,
    /// Not of unit length; zero of segments and points.
    pub normal: DVec3,
}

/// How many corners a primitive has.
pub(crate) fn corner_count(topology: Topology) -> usize {
    match topology {
        Topology::Triangles => 3,
        Topology::Lines => 2,
        Topology::Points => 1,
    }
}

/// Positions and indices, in the order of the tree's leaves.
#[derive(Debug)]
pub(super) struct MeshCorners {
    pub positions: Box<[[f32; 3]]>,
    pub indices: Indices,
    /// The primitive in the drawable, by place in the tree.
    pub order: Indices,
    pub corners: usize,
}

/// Indices as small as they can be.
#[derive(Debug)]
pub(super) enum Indices {
    Small(Box<[u16]>),
    Large(Box<[u32]>),
}

impl Indices {
    /// Takes 16 bits where all are below `limit` and that fits.
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
    pub fn vertices(&self, place: usize) -> [u32; 3] {
        let at = |n: usize| self.indices.at(place * self.corners + n.min(self.corners - 1));
        [at(0), at(1), at(2)]
    }

    #[inline(always)]
    pub fn of(&self, place: usize) -> Corners {
        self.vertices(place).map(|v| Vec3::from_array(self.positions[v as usize]).as_dvec3())
    }
}

/// Heights in steps of a power of two where they all lie on it, as those of `data-gen` do.
#[derive(Debug)]
enum Heights {
    Steps { lowest_m: f64, step_m: f64, steps: Box<[u16]> },
    Metres(Box<[f32]>),
}

impl Heights {
    /// Loses nothing: what does not lie on 65,536 steps stays as it is.
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

/// What is seen along a line: the line itself is a point.
pub(super) struct Sight {
    origin: DVec3,
    /// Unit vectors across the line and each other.
    right: DVec3,
    up: DVec3,
    /// What lies so far from the line at most is taken to be on both sides of it, metres.
    room_m: f64,
}

impl Sight {
    /// `up` is where the surface mostly faces: what passes above or below it is told apart best.
    pub fn new(ray: &Ray, up: DVec3, room_m: f64) -> Self {
        let along = ray.direction.normalize_or(DVec3::Z);
        let right = along.cross(up).try_normalize().unwrap_or_else(|| along.any_orthonormal_vector());
        Self { origin: ray.origin, right, up: right.cross(along), room_m }
    }

    /// The sides of the line that a point is on, one bit each: right, left, above, below.
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

/// Corners along a side of a leaf of cells.
const MAX_CORNERS: usize = 5;
/// Places in such a leaf.
const MAX_TRIANGLES: usize = 2 * (MAX_CORNERS - 1) * (MAX_CORNERS - 1);

/// The grid of a [`HeightTile`] without its border, two triangles a cell; places are cells along a Z-order curve.
#[derive(Debug)]
pub(super) struct HeightCorners {
    side: usize,
    p0_m: f64,
    rows: Box<[[f32; 4]]>,
    columns: Box<[[f32; 2]]>,
    heights: Heights,
}

impl HeightCorners {
    /// `None` for a tile whose tables do not fit each other, which is not drawn either.
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

    /// Column, row and which triangle: 0 is the south-eastern one.
    fn cell(place: usize) -> (usize, usize, usize) {
        let code = (place / 2) as u32;
        (even_bits(code), even_bits(code >> 1), place % 2)
    }

    /// Row by row from the south-west, two a cell.
    pub fn primitive(&self, place: usize) -> u32 {
        let (i, j, upper) = Self::cell(place);
        (2 * (j * (self.side - 1) + i) + upper) as u32
    }

    /// Row by row from the south-west.
    pub fn vertices(&self, place: usize) -> [u32; 3] {
        let (i, j, upper) = Self::cell(place);
        let at = |i: usize, j: usize| (j * self.side + i) as u32;
        if upper == 0 { [at(i, j), at(i + 1, j), at(i + 1, j + 1)] } else { [at(i, j), at(i + 1, j + 1), at(i, j + 1)] }
    }

    /// The formula of [`HeightTile`].
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
    pub fn of(&self, place: usize) -> Corners {
        let (i, j, upper) = Self::cell(place);
        let (a, c) = (self.vertex(i, j), self.vertex(i + 1, j + 1));
        if upper == 0 { [a, self.vertex(i + 1, j), c] } else { [a, c, self.vertex(i, j + 1)] }
    }

    /// Those triangles of a leaf that a line may meet, in their order: not those whose corners are all on one side of it.
    /// Each corner is computed once.
    #[inline(always)]
    pub fn along(&self, leaf: Range<usize>, sight: &Sight, mut visit: impl FnMut(usize, &Corners)) {
        let (i, j, _) = Self::cell(leaf.start);
        // A square of 4 x 4 cells, but 2 x 2 of the smallest tile.
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
        for place in leaf.step_by(2) {
            let (i, j, _) = Self::cell(place % MAX_TRIANGLES);
            let across = sides[j][i] & sides[j + 1][i + 1];
            if across & sides[j][i + 1] == 0 {
                visit(place, &[corners[j][i], corners[j][i + 1], corners[j + 1][i + 1]]);
            }
            if across & sides[j + 1][i] == 0 {
                visit(place + 1, &[corners[j][i], corners[j + 1][i + 1], corners[j + 1][i]]);
            }
        }
    }

    /// A triangle as it is drawn, its normal upwards: the tile's frame is left-handed.
    pub fn triangle(&self, place: usize) -> Primitive {
        let corners = self.of(place);
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a);
        let normal = if normal.dot(self.up(place)) < 0.0 { -normal } else { normal };
        Primitive { number: self.primitive(place), vertices: self.vertices(place), corners, count: 3, normal }
    }

    /// Away from the ground, at a cell.
    pub fn up(&self, place: usize) -> DVec3 {
        let (i, j, _) = Self::cell(place);
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

/// The bits 0, 2, 4, ... together.
fn even_bits(code: u32) -> usize {
    let mut x = code & 0x5555_5555;
    x = (x | (x >> 1)) & 0x3333_3333;
    x = (x | (x >> 2)) & 0x0f0f_0f0f;
    x = (x | (x >> 4)) & 0x00ff_00ff;
    x = (x | (x >> 8)) & 0x0000_ffff;
    x as usize
}

/// Primitives of a mesh with usable corners: number, indices, corners.
pub(crate) fn mesh_primitives(mesh: &Mesh) -> impl Iterator<Item = (u32, [u32; 3], Corners)> + '_ {
    let count = corner_count(mesh.topology);
    mesh.indices.chunks_exact(count).enumerate().filter_map(move |(number, list)| {
        let vertices = [0, 1, 2].map(|n: usize| list[n.min(count - 1)]);
        let corner = |v: u32| Some(Vec3::from_array(mesh.vertices.get(v as usize)?.position)).filter(|p| p.is_finite());
        let [a, b, c] = vertices.map(corner);
        Some((number as u32, vertices, [a?, b?, c?].map(|p| p.as_dvec3())))
    })
}

/// How many corners the primitives of a geometry have.
pub(crate) fn corners_of(geometry: &Geometry) -> usize {
    match geometry {
        Geometry::Mesh(mesh) => corner_count(mesh.topology),
        Geometry::Height(_) | Geometry::Custom(_) => 3,
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
    fn the_curve_meets_every_cell_once() {
        let mut seen: Vec<_> = (0..2 * 64).map(HeightCorners::cell).collect();
        assert!(seen.iter().take(8).all(|(i, j, _)| *i < 2 && *j < 2), "blocks first");
        seen.sort_unstable();
        let all: Vec<_> = (0..8).flat_map(|i| (0..8).flat_map(move |j| [(i, j, 0), (i, j, 1)])).collect();
        assert_eq!(seen, all);
    }

    proptest! {
        #[test]
        fn lines_along_the_ground_find_what_every_triangle_finds(
            level in 1u32..5,
            // The ends are between the lowest and the highest ground.
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
            let triangles = (0..corners.count()).map(|place| corners.triangle(place));
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
    fn heights_lose_nothing() {
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
