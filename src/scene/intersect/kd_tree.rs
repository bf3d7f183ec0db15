//! A k-d tree over the primitives of a drawable, after OSG's `KdTree`: primitives are divided at the median of the longest
//! axis, with a box around each half.
//!
//! Built by decode workers while the payload is there; kept in the page, read by any thread. The tree has no
//! pointers: node `n` has the children `2n + 1` and `2n + 2`, and the primitives below a node follow from its number.
//! Boxes have 12 bytes, in steps of the whole box, whose z axis is the primitives' mean normal: boxes of a slope lie flat on
//! it. Primitives are tested in f64 with exactly the positions that are drawn.

use glam::{DMat3, DVec3, DVec4, Vec3, Vec4};

use super::primitives::{Corners, HeightCorners, Indices, MeshCorners, Primitive, Sight, corners_of, mesh_primitives};
use crate::math::{BoundingSphere, Ray, slab};
use crate::scene::geometry::Geometry;

/// The maximum number of primitives in a leaf of a mesh; the boxes then take 3 to 6 bytes per triangle.
const MAX_IN_MESH_LEAF: usize = 8;
/// The maximum number of triangles in a leaf of a height tile: 4 x 4 cells.
const MAX_IN_HEIGHT_LEAF: usize = 32;

/// The number of steps of the whole box along each axis. It includes a margin of [`ROOM`] steps on both sides, and each box
/// is a step larger than its contents. The f32 rounding errors of the traversal are far smaller.
const STEPS: f64 = 65_535.0;
/// The margin of the whole box on each side, in steps.
const ROOM: f64 = 2.0;

/// Triangles are enlarged by this fraction: neighbouring tiles have tiny gaps from the rounding of their f32 positions, and
/// a line must not pass through.
pub(super) const EDGE_SLACK: f64 = 1e-5;
/// The overhang of an enlarged triangle as a fraction of its longest edge: at most three times the slack, with a margin.
const SIGHT_SLACK: f64 = 10.0 * EDGE_SLACK;

/// A box in steps of the whole box.
#[derive(Clone, Copy, Debug)]
struct StepBox {
    min: [u16; 3],
    max: [u16; 3],
}

#[derive(Debug)]
enum Store {
    Mesh(MeshCorners),
    Heights(HeightCorners),
}

/// The primitives of a drawable, arranged for intersection.
#[derive(Debug)]
pub struct KdTree {
    /// The rows are the axes of the boxes in the drawable's frame.
    box_from_drawable: DMat3,
    /// The lower corner of the whole box, in the axes of the boxes.
    origin: DVec3,
    /// The length of a step along each axis.
    step_m: DVec3,
    /// The number of levels below the root; there are 2^depth leaves.
    depth: u32,
    count: usize,
    boxes: Box<[StepBox]>,
    store: Store,
}

/// An intersection of a primitive with a line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineHit {
    pub primitive: u32,
    pub vertices: [u32; 3],
    pub ratio: f64,
    /// The weights of the corners; they sum to 1.
    pub weights: [f64; 3],
    /// The normal in the drawable's frame, not of unit length, on the side from which the corners are counter-clockwise; upwards
    /// for a height tile.
    pub normal: DVec3,
}

impl KdTree {
    /// Builds the tree of a geometry; `None` if it has no primitives.
    pub fn build(geometry: &Geometry) -> Option<Self> {
        match geometry {
            Geometry::Mesh(mesh) => {
                let corners = corners_of(geometry);
                let primitives: Vec<_> = mesh_primitives(mesh).collect();
                let axes = mean_axes(primitives.iter().map(|(_, _, corners)| *corners));
                let mut middles: Vec<(Vec3, u32)> = Vec::with_capacity(primitives.len());
                let first = primitives.first()?.2[0];
                for (place, (_, _, corners)) in primitives.iter().enumerate() {
                    let middle = (corners[0] + corners[1] + corners[2]) / 3.0 - first;
                    middles.push(((axes * middle).as_vec3(), place as u32));
                }
                let depth = depth_for(middles.len(), MAX_IN_MESH_LEAF);
                divide(&mut middles, depth);
                let ordered = || middles.iter().filter_map(|(_, place)| primitives.get(*place as usize));
                let store = MeshCorners {
                    positions: mesh.vertices.iter().map(|v| v.position).collect(),
                    indices: Indices::new(
                        ordered().flat_map(|(_, vertices, _)| vertices.iter().take(corners).copied()),
                        mesh.vertices.len(),
                    ),
                    order: Indices::new(ordered().map(|(number, ..)| *number), mesh.indices.len() / corners),
                    corners,
                };
                Some(Self::with_boxes(Store::Mesh(store), axes, depth, middles.len()))
            }
            Geometry::Splats(_) | Geometry::Custom(_) => None,
            Geometry::Height(tile) => {
                let store = HeightCorners::new(tile)?;
                let count = store.count();
                let axes = mean_axes((0..count).map(|place| store.of(place)));
                Some(Self::with_boxes(Store::Heights(store), axes, depth_for(count, MAX_IN_HEIGHT_LEAF), count))
            }
        }
    }

    fn with_boxes(store: Store, box_from_drawable: DMat3, depth: u32, count: usize) -> Self {
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for place in 0..count {
            for corner in store.corners(place).map(|c| box_from_drawable * c) {
                (min, max) = (min.min(corner), max.max(corner));
            }
        }
        let extent = max - min;
        // No axis is thinner than the f32 resolution along the longest one.
        let least = (extent.max_element() * 1e-7).max(1e-9);
        let step_m = extent.max(DVec3::splat(least)) / (STEPS - 2.0 * ROOM);
        let origin = min - step_m * ROOM;
        let nothing = StepBox { min: [u16::MAX; 3], max: [0; 3] };
        let leaves = 1usize << depth;
        let mut tree = Self { box_from_drawable, origin, step_m, depth, count, boxes: Box::default(), store };
        let mut boxes = vec![nothing; 2 * leaves - 1];
        for leaf in 0..leaves {
            let target = &mut boxes[leaves - 1 + leaf];
            for place in tree.places(leaf) {
                for corner in tree.store.corners(place) {
                    let steps = (box_from_drawable * corner - origin) / step_m;
                    for axis in 0..3 {
                        target.min[axis] = target.min[axis].min((steps[axis].floor() - 1.0).clamp(0.0, STEPS) as u16);
                        target.max[axis] = target.max[axis].max((steps[axis].ceil() + 1.0).clamp(0.0, STEPS) as u16);
                    }
                }
            }
        }
        for node in (0..leaves - 1).rev() {
            let (a, b) = (boxes[2 * node + 1], boxes[2 * node + 2]);
            for axis in 0..3 {
                boxes[node].min[axis] = a.min[axis].min(b.min[axis]);
                boxes[node].max[axis] = a.max[axis].max(b.max[axis]);
            }
        }
        tree.boxes = boxes.into();
        tree
    }

    /// Returns the number of triangles, segments or points.
    pub fn primitive_count(&self) -> usize {
        self.count
    }

    /// Returns true for the tree of a height tile, whose skirt it leaves out.
    pub(crate) fn is_of_heights(&self) -> bool {
        matches!(self.store, Store::Heights(_))
    }

    /// Returns the bytes of CPU memory.
    pub fn size_bytes(&self) -> u64 {
        let store = match &self.store {
            Store::Mesh(mesh) => mesh.positions.len() * 12 + mesh.indices.size_bytes() + mesh.order.size_bytes(),
            Store::Heights(heights) => heights.size_bytes(),
        };
        (size_of::<Self>() + self.boxes.len() * size_of::<StepBox>() + store) as u64
    }

    /// Returns a sphere around all primitives, in the drawable's frame.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        let half = 0.5 * STEPS * self.step_m;
        BoundingSphere::new(self.box_from_drawable.transpose() * (self.origin + half), half.length())
    }

    /// Returns the range of a leaf's primitives.
    fn places(&self, leaf: usize) -> std::ops::Range<usize> {
        (self.count * leaf) >> self.depth..(self.count * (leaf + 1)) >> self.depth
    }

    /// Intersects triangles with a line, roughly from near to far. `found` returns the ratio up to which the search continues.
    pub(crate) fn intersect_line(&self, ray: &Ray, mut found: impl FnMut(&LineHit) -> f64) {
        if self.store.corners_of_each() != 3 {
            return;
        }
        let origin = (self.box_from_drawable * ray.origin - self.origin) / self.step_m;
        let direction = (self.box_from_drawable * ray.direction) / self.step_m;
        let (first, last) = slab(origin, direction, DVec3::ZERO, DVec3::splat(STEPS));
        let mut max_ratio = ray.max_ratio;
        let (first, last) = (first.max(0.0), last.min(max_ratio));
        if first >= last || !first.is_finite() || !last.is_finite() {
            return;
        }
        // From here on the ray is the part inside the whole box, with ratios of 0 to 1 and coordinates that f32 can hold.
        let span = last - first;
        let near = Ray { origin: ray.at(first), direction: ray.direction * span, max_ratio: 1.0 };
        let walk = Walk::new(origin + direction * first, direction * span);
        let sight = self.is_of_heights().then(|| {
            let longest_m = (STEPS * self.step_m).length();
            Sight::new(&near, self.box_from_drawable.row(2), SIGHT_SLACK * longest_m)
        });
        let share_of = |ratio: f64| ((ratio - first) / span) as f32 * 1.000_001 + 1e-6;
        let mut max_share = 1.0f32;
        let leaves = (1usize << self.depth) - 1;
        let mut stack = [(0usize, 0f32); 40];
        stack[0] = (0, walk.enters(&self.boxes[0]).unwrap_or(f32::INFINITY));
        let mut open = 1;
        while open > 0 {
            open -= 1;
            let (mut node, mut enters) = stack[open];
            loop {
                if enters > max_share {
                    break;
                }
                if node >= leaves {
                    let mut look = |place: usize, corners: &Corners| {
                        let Some((share, weights, normal)) = meet(&near, corners) else { return };
                        let ratio = first + share * span;
                        if (0.0..=max_ratio).contains(&ratio) {
                            let hit = self.hit(place, ratio, weights, normal);
                            max_ratio = max_ratio.min(found(&hit));
                            max_share = max_share.min(share_of(max_ratio));
                        }
                    };
                    let leaf = self.places(node - leaves);
                    match (&self.store, &sight) {
                        (Store::Heights(heights), Some(sight)) => heights.along(leaf, sight, look),
                        (store, _) => leaf.for_each(|place| look(place, &store.corners(place))),
                    }
                    break;
                }
                let (left, right) = (2 * node + 1, 2 * node + 2);
                let (a, b) = (walk.enters(&self.boxes[left]), walk.enters(&self.boxes[right]));
                (node, enters) = match (a, b) {
                    (Some(a), Some(b)) => {
                        let ((near, near_at), (far, far_at)) =
                            if a <= b { ((left, a), (right, b)) } else { ((right, b), (left, a)) };
                        stack[open] = (far, far_at);
                        open += 1;
                        (near, near_at)
                    }
                    (Some(a), None) => (left, a),
                    (None, Some(b)) => (right, b),
                    (None, None) => break,
                };
            }
        }
    }

    fn hit(&self, place: usize, ratio: f64, weights: [f64; 3], normal: DVec3) -> LineHit {
        LineHit {
            primitive: self.store.primitive(place),
            vertices: self.store.vertices(place),
            ratio,
            weights,
            normal: self.store.facing(place, normal),
        }
    }

    /// Visits the primitives of leaves in boxes for which `boxes` returns true, until `visit` returns false.
    pub(crate) fn visit_in(
        &self,
        boxes: &mut dyn FnMut(&BoxInDrawable) -> bool,
        visit: &mut dyn FnMut(&Primitive) -> bool,
    ) {
        let axes = self.box_from_drawable.transpose();
        let leaves = (1usize << self.depth) - 1;
        let mut stack = [0usize; 40];
        let mut open = 1;
        while open > 0 {
            open -= 1;
            let node = stack[open];
            let steps = &self.boxes[node];
            let min = self.origin + self.step_m * DVec3::from_array(steps.min.map(f64::from));
            let max = self.origin + self.step_m * DVec3::from_array(steps.max.map(f64::from));
            if !boxes(&BoxInDrawable { center: axes * (0.5 * (min + max)), half: 0.5 * (max - min), axes }) {
                continue;
            }
            if node < leaves {
                (stack[open], stack[open + 1]) = (2 * node + 2, 2 * node + 1);
                open += 2;
                continue;
            }
            for place in self.places(node - leaves) {
                let corners = self.store.corners(place);
                let [a, b, c] = corners;
                let primitive = Primitive {
                    number: self.store.primitive(place),
                    vertices: self.store.vertices(place),
                    corners,
                    count: self.store.corners_of_each(),
                    normal: self.store.facing(place, (b - a).cross(c - a)),
                };
                if !visit(&primitive) {
                    return;
                }
            }
        }
    }
}

/// A node's box in the drawable's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BoxInDrawable {
    pub center: DVec3,
    /// Half the size along the axes, metres.
    pub half: DVec3,
    /// The axes as columns, of unit length.
    pub axes: DMat3,
}

impl BoxInDrawable {
    /// Returns the smallest and largest `normal . p + d` in the box.
    pub fn range(&self, plane: DVec4) -> (f64, f64) {
        let normal = plane.truncate();
        let middle = normal.dot(self.center) + plane.w;
        let reach = (self.axes.transpose() * normal).abs().dot(self.half);
        (middle - reach, middle + reach)
    }
}

impl Store {
    #[inline(always)]
    fn corners(&self, place: usize) -> Corners {
        match self {
            Self::Mesh(mesh) => mesh.of(place),
            Self::Heights(heights) => heights.of(place),
        }
    }

    fn corners_of_each(&self) -> usize {
        match self {
            Self::Mesh(mesh) => mesh.corners,
            Self::Heights(_) => 3,
        }
    }

    fn primitive(&self, place: usize) -> u32 {
        match self {
            Self::Mesh(mesh) => mesh.order.at(place),
            Self::Heights(heights) => heights.primitive(place),
        }
    }

    fn vertices(&self, place: usize) -> [u32; 3] {
        match self {
            Self::Mesh(mesh) => mesh.vertices(place),
            Self::Heights(heights) => heights.vertices(place),
        }
    }

    /// Returns the normal on the front side: upwards for height tiles, whose frame is left-handed.
    fn facing(&self, place: usize, normal: DVec3) -> DVec3 {
        match self {
            Self::Heights(heights) if normal.dot(heights.up(place)) < 0.0 => -normal,
            _ => normal,
        }
    }
}

/// A line in steps of a tree, for all axes at once; z is stored twice.
struct Walk {
    origin: Vec4,
    per_step: Vec4,
}

impl Walk {
    fn new(origin: DVec3, direction: DVec3) -> Self {
        // A zero component is replaced by a tiny one, so that no product is NaN.
        let least = Vec4::splat(1e-30);
        let along = xyzz(direction.as_vec3().to_array());
        let per_step = Vec4::select(along.abs().cmplt(least), least, along).recip();
        Self { origin: xyzz(origin.as_vec3().to_array()), per_step }
    }

    /// Returns the ratio at which the line enters a box.
    #[inline(always)]
    fn enters(&self, steps: &StepBox) -> Option<f32> {
        let share = |steps: [u16; 3]| (xyzz(steps.map(f32::from)) - self.origin) * self.per_step;
        let (a, b) = (share(steps.min), share(steps.max));
        let first = a.min(b).max(Vec4::ZERO).max_element();
        let last = a.max(b).min(Vec4::ONE).min_element();
        (first <= last).then_some(first)
    }
}

#[inline(always)]
fn xyzz([x, y, z]: [f32; 3]) -> Vec4 {
    Vec4::new(x, y, z, z)
}

/// Intersects a line with a triangle. Returns the ratio of the ray, the weights of the corners and the normal. Moeller and
/// Trumbore, 1997.
pub(crate) fn meet(ray: &Ray, corners: &Corners) -> Option<(f64, [f64; 3], DVec3)> {
    let [a, b, c] = *corners;
    let (ab, ac) = (b - a, c - a);
    let across = ray.direction.cross(ac);
    let determinant = ab.dot(across);
    if determinant == 0.0 {
        return None;
    }
    let per_determinant = 1.0 / determinant;
    let from_a = ray.origin - a;
    let inside = -EDGE_SLACK..=1.0 + EDGE_SLACK;
    let v = from_a.dot(across) * per_determinant;
    if !inside.contains(&v) {
        return None;
    }
    let turned = from_a.cross(ab);
    let w = ray.direction.dot(turned) * per_determinant;
    if !inside.contains(&w) || v + w > 1.0 + EDGE_SLACK {
        return None;
    }
    let share = ac.dot(turned) * per_determinant;
    share.is_finite().then(|| (share, [1.0 - v - w, v, w], ab.cross(ac)))
}

/// Returns the depth at which no leaf has more than `max_in_leaf` primitives.
fn depth_for(count: usize, max_in_leaf: usize) -> u32 {
    count.div_ceil(max_in_leaf).max(1).next_power_of_two().trailing_zeros()
}

/// Returns axes as rows, with z along the triangles' mean normal; the frame's own axes if the normals diverge.
fn mean_axes(corners: impl Iterator<Item = Corners>) -> DMat3 {
    let (mut sum, mut area) = (DVec3::ZERO, 0.0);
    for [a, b, c] in corners {
        let normal = (b - a).cross(c - a);
        sum += normal;
        area += normal.length();
    }
    match sum.try_normalize() {
        Some(z) if sum.length() > 0.3 * area => {
            let x = z.any_orthonormal_vector();
            DMat3::from_cols(x, z.cross(x), z).transpose()
        }
        _ => DMat3::IDENTITY,
    }
}

/// Orders primitives so that those of each node are divided at the median of the axis along which their centres spread
/// farthest.
pub(super) fn divide(middles: &mut [(Vec3, u32)], depth: u32) {
    let count = middles.len();
    for level in 0..depth {
        for node in 0..1usize << level {
            let first = (count * node) >> level;
            let end = (count * (node + 1)) >> level;
            let middle = (count * (2 * node + 1)) >> (level + 1);
            let Some(range) = middles.get_mut(first..end).filter(|r| r.len() > 1) else { continue };
            let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            for (p, _) in range.iter() {
                (min, max) = (min.min(*p), max.max(*p));
            }
            let axis = (max - min).max_position();
            // Ties are broken by index, so that equal input gives equal trees.
            range.select_nth_unstable_by(middle - first, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use crate::scene::geometry::{Mesh, MeshVertex, Topology};

    fn mesh(corners: &[[f32; 3]]) -> Geometry {
        let vertices: Vec<_> = corners.iter().map(|p| MeshVertex { position: *p, ..MeshVertex::default() }).collect();
        let indices = (0..corners.len() as u32 / 3 * 3).collect();
        Geometry::Mesh(Arc::new(Mesh::new(vertices, indices, Topology::Triangles)))
    }

    /// Tests every triangle, one after the other.
    fn brute_force(geometry: &Geometry, ray: &Ray) -> Vec<(u32, f64)> {
        let Geometry::Mesh(mesh) = geometry else { return Vec::new() };
        mesh_primitives(mesh)
            .filter_map(|(number, _, corners)| meet(ray, &corners).map(|(ratio, ..)| (number, ratio)))
            .filter(|(_, ratio)| (0.0..=ray.max_ratio).contains(ratio))
            .collect()
    }

    fn all(tree: &KdTree, ray: &Ray) -> Vec<(u32, f64)> {
        let mut hits = Vec::new();
        tree.intersect_line(ray, |hit| {
            hits.push((hit.primitive, hit.ratio));
            f64::INFINITY
        });
        hits.sort_by_key(|h| h.0);
        hits
    }

    fn nearest(tree: &KdTree, ray: &Ray) -> Option<f64> {
        let mut nearest = None;
        tree.intersect_line(ray, |hit| {
            nearest = Some(hit.ratio);
            hit.ratio
        });
        nearest
    }

    fn point(reach: f32) -> impl Strategy<Value = [f32; 3]> {
        [-reach..reach, -reach..reach, -reach..reach]
    }

    proptest! {
        #[test]
        fn the_tree_matches_a_brute_force_search(
            corners in prop::collection::vec(point(100.0), 3..600),
            lines in prop::collection::vec((point(150.0), point(150.0)), 20),
        ) {
            let geometry = mesh(&corners);
            let tree = KdTree::build(&geometry).unwrap();
            for (start, end) in lines {
                let ray = Ray::segment(Vec3::from_array(start).as_dvec3(), Vec3::from_array(end).as_dvec3());
                let expected = brute_force(&geometry, &ray);
                let found = all(&tree, &ray);
                prop_assert_eq!(found.len(), expected.len());
                for (a, b) in found.iter().zip(&expected) {
                    prop_assert!(a.0 == b.0 && (a.1 - b.1).abs() < 1e-9, "{:?} {:?}", a, b);
                }
                let least = expected.iter().map(|h| h.1).min_by(f64::total_cmp);
                let found = nearest(&tree, &ray);
                prop_assert!(found.zip(least).map_or(found == least, |(a, b)| (a - b).abs() < 1e-9));
            }
        }

        #[test]
        fn far_and_near_origins_find_the_same(start in point(100.0), at in point(40.0), corners in prop::collection::vec(point(50.0), 300)) {
            let geometry = mesh(&corners);
            let tree = KdTree::build(&geometry).unwrap();
            let target = Vec3::from_array(at).as_dvec3();
            let away = (Vec3::from_array(start).as_dvec3() - target).normalize_or(DVec3::X);
            let far = Ray::infinite(target + away * 4e7, -away);
            let near = Ray::infinite(target + away * 400.0, -away);
            let (far, near) = (all(&tree, &far), all(&tree, &near));
            // The far origin is rounded to 7e-9 m, so a grazing hit may differ.
            prop_assert!(far.len().abs_diff(near.len()) <= 1);
            if far.len() == near.len() {
                for (a, b) in far.iter().zip(&near) {
                    prop_assert!((a.1 - b.1 - (4e7 - 400.0)).abs() < 1e-3, "{:?} {:?}", a, b);
                }
            }
        }
    }

    #[test]
    fn flat_and_thin_and_single_triangles_are_met() {
        let flat: Vec<[f32; 3]> =
            (0..300).map(|i| [(i / 3) as f32 + [0.0, 1.0, 0.0][i % 3], [0.0, 0.0, 1.0][i % 3], 5.0]).collect();
        for corners in [&flat[..], &flat[..3], &flat[..30]] {
            let tree = KdTree::build(&mesh(corners)).unwrap();
            let down = Ray::segment(DVec3::new(0.25, 0.25, 9.0), DVec3::new(0.25, 0.25, 1.0));
            assert_eq!(all(&tree, &down), vec![(0, 0.5)]);
            assert!(all(&tree, &Ray::infinite(down.origin, DVec3::Z)).is_empty(), "behind");
            assert!(all(&tree, &Ray { max_ratio: 0.4, ..down }).is_empty(), "beyond the end");
        }
    }

    #[test]
    fn empty_and_non_finite_primitives_are_left_out() {
        assert!(KdTree::build(&mesh(&[])).is_none());
        let mut corners = vec![[f32::NAN, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert!(KdTree::build(&mesh(&corners)).is_none());
        corners.extend([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]);
        let tree = KdTree::build(&mesh(&corners)).unwrap();
        assert_eq!(tree.primitive_count(), 1);
        let down = Ray::infinite(DVec3::new(0.2, 0.2, 3.0), DVec3::NEG_Z);
        assert_eq!(all(&tree, &down), vec![(1, 2.0)]);
    }
}
