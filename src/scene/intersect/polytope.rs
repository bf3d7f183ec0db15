//! Intersections with convex volumes: a rectangle of the picture, a box, a tube.

use glam::{DAffine3, DMat3, DVec3, DVec4};

use super::primitives::Primitive;
use super::surface::Surface;
use super::visitor::{Intersect, Intersection, IntersectionLimit, Intersector, Met};
use super::walk::{Candidate, Probe};

/// Which primitives a [`PolytopeIntersector`] meets; OSG's dimension mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dimensions {
    /// Points.
    pub points: bool,
    /// Segments.
    pub lines: bool,
    /// Triangles.
    pub triangles: bool,
}

impl Dimensions {
    /// All of them.
    pub const ALL: Self = Self { points: true, lines: true, triangles: true };

    fn has(self, corners: usize) -> bool {
        match corners {
            1 => self.points,
            2 => self.lines,
            _ => self.triangles,
        }
    }
}

/// Meets points, segments and triangles of which something is inside a convex polytope.
#[derive(Clone, Debug)]
pub struct PolytopeIntersector {
    planes: Vec<DVec4>,
    reference: DVec4,
    limit: IntersectionLimit,
    dimensions: Dimensions,
    met: Vec<Met>,
    intersections: Vec<Intersection>,
    cut: Vec<DVec3>,
    spare: Vec<DVec3>,
}

/// The planes in a frame.
#[derive(Clone, Debug)]
pub struct LocalPolytope {
    planes: Vec<DVec4>,
    reference: DVec4,
}

impl PolytopeIntersector {
    /// Where `normal . p + d >= 0` for all planes (xyz is the normal, w is d), metres in the world. Intersections are
    /// ordered by `reference`, of which the normal is of unit length. With a plane that is not finite nothing is met.
    pub fn new(planes: Vec<DVec4>, reference: DVec4) -> Self {
        Self {
            planes,
            reference,
            limit: IntersectionLimit::NoLimit,
            dimensions: Dimensions::ALL,
            met: Vec::new(),
            intersections: Vec::new(),
            cut: Vec::new(),
            spare: Vec::new(),
        }
    }

    /// A box along the axes of the world, ordered upwards.
    pub fn in_box(min: DVec3, max: DVec3) -> Self {
        let planes = [DVec3::X, DVec3::Y, DVec3::Z]
            .into_iter()
            .flat_map(|axis| [axis.extend(-axis.dot(min)), (-axis).extend(axis.dot(max))])
            .collect();
        Self::new(planes, DVec4::new(0.0, 0.0, 1.0, -min.z))
    }

    /// The same, keeping other intersections.
    pub fn with_limit(mut self, limit: IntersectionLimit) -> Self {
        self.limit = limit;
        self
    }

    /// The same, meeting other primitives.
    pub fn with_dimensions(mut self, dimensions: Dimensions) -> Self {
        self.dimensions = dimensions;
        self
    }

    /// What the last traversal met, by distance from the reference plane.
    pub fn intersections(&self) -> &[Intersection] {
        &self.intersections
    }

    /// The nearest one.
    pub fn first_intersection(&self) -> Option<&Intersection> {
        self.intersections.first()
    }

    /// Takes them out.
    pub fn take_intersections(&mut self) -> Vec<Intersection> {
        std::mem::take(&mut self.intersections)
    }

    /// Keeps a primitive, if the limit lets it. False: no other of the drawable is wanted.
    fn keep(&mut self, before: usize, new: Met) -> bool {
        let kept = match self.limit {
            IntersectionLimit::NoLimit => None,
            IntersectionLimit::OnePerDrawable => self.met.get_mut(before),
            IntersectionLimit::One | IntersectionLimit::Nearest => self.met.first_mut(),
        };
        match kept {
            Some(kept) => {
                if new.ratio.total_cmp(&kept.ratio).then(new.primitive.cmp(&kept.primitive)).is_lt() {
                    *kept = new;
                }
            }
            None => self.met.push(new),
        }
        self.limit != IntersectionLimit::One
    }
}

impl Probe for PolytopeIntersector {
    type Local = LocalPolytope;

    fn local(&self, world_from_frame: &DAffine3) -> Option<LocalPolytope> {
        let normals = world_from_frame.matrix3.transpose();
        let move_back = |plane: &DVec4| {
            let normal = plane.truncate();
            (normals * normal).extend(normal.dot(world_from_frame.translation) + plane.w)
        };
        let local = LocalPolytope {
            planes: self.planes.iter().map(move_back).collect(),
            reference: move_back(&self.reference),
        };
        let is_finite = local.planes.iter().chain([&local.reference]).all(|p| p.is_finite());
        (is_finite && !local.planes.is_empty()).then_some(local)
    }

    fn enters_sphere(local: &LocalPolytope, center: DVec3, radius_m: f64) -> Option<f64> {
        local.enters(center, |normal| normal.length() * radius_m)
    }

    fn enters_box(local: &LocalPolytope, center: DVec3, axes: &DMat3, half: DVec3) -> Option<f64> {
        let across = axes.transpose();
        local.enters(center, |normal| (across * normal).abs().dot(half))
    }
}

impl LocalPolytope {
    /// Least distance from the reference plane of something around a centre, unless it is outside of a plane.
    fn enters(&self, center: DVec3, reach: impl Fn(DVec3) -> f64) -> Option<f64> {
        let nearest = |p: &DVec4, sign: f64| p.truncate().dot(center) + p.w + sign * reach(p.truncate());
        let is_met = self.planes.iter().all(|p| nearest(p, 1.0) >= 0.0);
        is_met.then(|| nearest(&self.reference, -1.0))
    }
}

impl Intersect for PolytopeIntersector {
    fn clear(&mut self) {
        self.met.clear();
        self.intersections.clear();
    }

    fn is_done(&self, enters: f64) -> bool {
        match self.limit {
            IntersectionLimit::Nearest => self.met.first().is_some_and(|nearest| enters > nearest.ratio),
            IntersectionLimit::One => !self.met.is_empty(),
            IntersectionLimit::NoLimit | IntersectionLimit::OnePerDrawable => false,
        }
    }

    fn meet(&mut self, candidate: &Candidate, surface: &Surface) {
        let Some(local) = self.local(&candidate.world_from_drawable) else { return };
        let before = self.met.len();
        let mut boxes = |b: &super::kd_tree::BoxInDrawable| local.planes.iter().all(|plane| b.range(*plane).1 >= 0.0);
        let (mut cut, mut spare) = (std::mem::take(&mut self.cut), std::mem::take(&mut self.spare));
        surface.visit_in(&mut boxes, &mut |primitive| {
            if !self.dimensions.has(primitive.count) {
                return true;
            }
            cut.clear();
            cut.extend_from_slice(&primitive.corners[..primitive.count.min(3)]);
            for plane in &local.planes {
                cut_off(&mut cut, &mut spare, *plane);
            }
            let Some(sum) = cut.iter().copied().reduce(|a, b| a + b) else { return true };
            let local_point = sum / cut.len() as f64;
            let distance = |p: &DVec3| local.reference.truncate().dot(*p) + local.reference.w;
            let new = Met {
                candidate: *candidate,
                primitive: primitive.number,
                vertices: primitive.vertices,
                weights: weights_of(primitive, local_point),
                ratio: cut.iter().map(distance).fold(f64::INFINITY, f64::min),
                max_ratio: cut.iter().map(distance).fold(f64::NEG_INFINITY, f64::max),
                local_point,
                local_normal: primitive.normal,
            };
            self.keep(before, new)
        });
        (self.cut, self.spare) = (cut, spare);
    }

    fn results(&mut self) -> (&mut Vec<Met>, &mut Vec<Intersection>) {
        (&mut self.met, &mut self.intersections)
    }
}

impl Intersector for PolytopeIntersector {}

/// Keeps of a convex polygon, segment or point what is on the positive side of a plane. Sutherland and Hodgman, 1974.
fn cut_off(corners: &mut Vec<DVec3>, spare: &mut Vec<DVec3>, plane: DVec4) {
    let side = |p: DVec3| plane.truncate().dot(p) + plane.w;
    if corners.iter().all(|p| side(*p) >= 0.0) {
        return;
    }
    spare.clear();
    let is_closed = corners.len() > 2;
    for (i, &b) in corners.iter().enumerate() {
        let before = if i > 0 { corners.get(i - 1) } else { corners.last().filter(|_| is_closed) };
        let at_b = side(b);
        if let Some(&a) = before {
            let at_a = side(a);
            if (at_a < 0.0) != (at_b < 0.0) {
                spare.push(a + (b - a) * (at_a / (at_a - at_b)));
            }
        }
        if at_b >= 0.0 {
            spare.push(b);
        }
    }
    std::mem::swap(corners, spare);
}

/// Shares of a primitive's corners in a point of it.
fn weights_of(primitive: &Primitive, point: DVec3) -> [f64; 3] {
    let [a, b, c] = primitive.corners;
    let from_a = point - a;
    match primitive.count {
        1 => [1.0, 0.0, 0.0],
        2 => {
            let share = from_a.dot(b - a) / (b - a).length_squared();
            let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
            [1.0 - share, share, 0.0]
        }
        _ => {
            let normal = primitive.normal;
            let twice_area = (b - a).cross(c - a).dot(normal);
            let v = from_a.cross(c - a).dot(normal) / twice_area;
            let w = (b - a).cross(from_a).dot(normal) / twice_area;
            if v.is_finite() && w.is_finite() { [1.0 - v - w, v, w] } else { [1.0, 0.0, 0.0] }
        }
    }
}
