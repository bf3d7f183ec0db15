//! Intersections with convex volumes: a rectangle of an image, a box, a tube.

use glam::{DAffine3, DMat3, DVec2, DVec3, DVec4};

use super::intersection::{Intersect, Intersection, IntersectionLimit, Intersector, Met};
use super::primitives::Primitive;
use super::probe::{Candidate, Probe};
use super::surface::Surface;
use super::window::WindowView;
use crate::math::Ray;

/// The kinds of primitives that a [`PolytopeIntersector`] meets; OSG's dimension mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dimensions {
    /// True if points are met.
    pub points: bool,
    /// True if line segments are met.
    pub lines: bool,
    /// True if triangles are met.
    pub triangles: bool,
}

impl Dimensions {
    /// All kinds of primitives.
    pub const ALL: Self = Self { points: true, lines: true, triangles: true };

    fn has(self, corners: usize) -> bool {
        match corners {
            1 => self.points,
            2 => self.lines,
            _ => self.triangles,
        }
    }
}

/// Finds points, segments and triangles that are partly inside a convex polytope.
#[derive(Clone, Debug)]
pub struct PolytopeIntersector {
    /// The polytope as given, followed by those of other projections met in the last traversal.
    views: Vec<PolytopeView>,
    /// Two corners of a rectangle in an image, pixels.
    at: Option<[DVec2; 2]>,
    limit: IntersectionLimit,
    dimensions: Dimensions,
    met: Vec<Met>,
    intersections: Vec<Intersection>,
    cut: Vec<DVec3>,
    spare: Vec<DVec3>,
}

/// The planes of a view, in the world.
#[derive(Clone, Debug)]
struct PolytopeView {
    planes: Vec<DVec4>,
    reference: DVec4,
    /// The line through the rectangle's centre in eye space with the view, if the polytope was given in an image.
    in_eye: Option<(Ray, WindowView)>,
}

impl PolytopeView {
    /// Creates the planes of an image rectangle, ordered by the distance from the eye; `None` if it is outside the viewport.
    fn seen([from, to]: [DVec2; 2], window: &WindowView, is_first: bool) -> Option<Self> {
        let [least, most] = window.corners();
        let (min, max) = (from.min(to), from.max(to));
        let (min, max) = if is_first { (min, max) } else { (min.max(least), max.min(most)) };
        if !min.cmplt(max).all() {
            return None;
        }
        let middle = window.line_at(0.5 * (min + max), is_first)?;
        let corners = [min, DVec2::new(max.x, min.y), max, DVec2::new(min.x, max.y), min];
        let world = window.world_from_eye;
        let in_world = |plane: DVec4| {
            let normal = world.matrix3 * plane.truncate();
            normal.extend(plane.w - normal.dot(world.translation))
        };
        let mut planes = Vec::with_capacity(6);
        for side in corners.windows(2) {
            let &[a, b] = side else { continue };
            let (near, far, beside) = (window.eye_at(a, 1.0)?, window.eye_at(a, 0.5)?, window.eye_at(b, 1.0)?);
            let normal = (far - near).cross(beside - near).try_normalize()?;
            let plane = normal.extend(-normal.dot(near));
            // The plane faces inwards, also if the projection mirrors.
            let inside = plane.dot(middle.at(1.0).extend(1.0));
            planes.push(in_world(plane * inside.signum()));
        }
        let forward = DVec4::new(0.0, 0.0, -1.0, 0.0);
        if window.begins_at_eye(is_first) {
            planes.push(in_world(forward));
        } else {
            let (depth, w) = (window.clip_from_eye.row(2), window.clip_from_eye.row(3));
            let cuts = [w - depth, depth].into_iter().filter(|plane| plane.truncate() != DVec3::ZERO);
            planes.extend(cuts.map(|plane| in_world(plane / plane.truncate().length())));
        }
        Some(Self { planes, reference: in_world(forward), in_eye: Some((middle, *window)) })
    }
}

/// The planes in the frame of a node or drawable.
#[derive(Clone, Debug)]
pub struct LocalPolytope {
    planes: Vec<DVec4>,
    reference: DVec4,
}

impl PolytopeIntersector {
    /// Creates the polytope in which `normal . p + d >= 0` for all planes (xyz is the normal, w is d), metres in the world.
    /// Intersections are ordered by the distance from `reference`, whose normal has unit length. A polytope with a plane that
    /// is not finite meets nothing.
    pub fn new(planes: Vec<DVec4>, reference: DVec4) -> Self {
        Self {
            views: vec![PolytopeView { planes, reference, in_eye: None }],
            at: None,
            limit: IntersectionLimit::NoLimit,
            dimensions: Dimensions::ALL,
            met: Vec::new(),
            intersections: Vec::new(),
            cut: Vec::new(),
            spare: Vec::new(),
        }
    }

    /// Creates a box along the axes of the world, ordered upwards.
    pub fn in_box(min: DVec3, max: DVec3) -> Self {
        let planes = [DVec3::X, DVec3::Y, DVec3::Z]
            .into_iter()
            .flat_map(|axis| [axis.extend(-axis.dot(min)), (-axis).extend(axis.dot(max))])
            .collect();
        Self::new(planes, DVec4::new(0.0, 0.0, 1.0, -min.z))
    }

    /// Creates the polytope of an image rectangle, given by any two opposite corners in pixels. It meets geometry of every
    /// projection that draws there, ordered by the distance from the eye. A rectangle without area meets nothing.
    ///
    /// Ratios of other projections are converted to the position of equal depth in the given view. Geometry drawn over
    /// others comes first, whatever its ratio.
    pub fn at_window(view: &WindowView, from_px: DVec2, to_px: DVec2) -> Self {
        let nothing = Self::new(vec![DVec4::NAN], DVec4::NAN);
        match PolytopeView::seen([from_px, to_px], view, true) {
            Some(seen) => Self { views: vec![seen], at: Some([from_px, to_px]), ..nothing },
            None => nothing,
        }
    }

    /// Sets which intersections are kept.
    pub fn with_limit(mut self, limit: IntersectionLimit) -> Self {
        self.limit = limit;
        self
    }

    /// Sets which kinds of primitives are met.
    pub fn with_dimensions(mut self, dimensions: Dimensions) -> Self {
        self.dimensions = dimensions;
        self
    }

    /// Returns the intersections of the last traversal, by distance from the reference plane.
    pub fn intersections(&self) -> &[Intersection] {
        &self.intersections
    }

    /// Returns the nearest intersection.
    pub fn first_intersection(&self) -> Option<&Intersection> {
        self.intersections.first()
    }

    /// Takes the intersections.
    pub fn take_intersections(&mut self) -> Vec<Intersection> {
        std::mem::take(&mut self.intersections)
    }

    /// Keeps a primitive if the limit allows. Returns false if no further primitive of the drawable is needed.
    fn keep(&mut self, before: usize, new: Met) -> bool {
        let kept = match self.limit {
            IntersectionLimit::NoLimit => None,
            IntersectionLimit::OnePerDrawable => self.met.get_mut(before),
            IntersectionLimit::One | IntersectionLimit::Nearest => self.met.first_mut(),
        };
        match kept {
            Some(kept) => {
                let over = new.candidate.layer.cmp(&kept.candidate.layer);
                let order = over.then(new.ratio.total_cmp(&kept.ratio));
                if order.then(new.primitive.cmp(&kept.primitive)).is_lt() {
                    *kept = new;
                }
            }
            None => self.met.push(new),
        }
        self.limit != IntersectionLimit::One
    }

    /// Converts a distance from the eye of another view to the distance of equal depth in the given view.
    fn given_distance(&self, view: usize, distance_m: f64) -> f64 {
        let in_eye = |view: usize| self.views.get(view).and_then(|v| v.in_eye);
        let (Some((_, window)), Some((middle, other))) = (in_eye(0), in_eye(view)) else { return distance_m };
        let point = middle.at((-distance_m - middle.origin.z) / middle.direction.z);
        let found = window.eye_of_other(&other, point);
        found.map_or(0.0, |(p, is_beyond)| if is_beyond { distance_m - p.z } else { -p.z })
    }
}

impl Probe for PolytopeIntersector {
    type Local = LocalPolytope;

    fn local(&self, view: u32, world_from_frame: &DAffine3) -> Option<LocalPolytope> {
        let view = self.views.get(view as usize)?;
        let normals = world_from_frame.matrix3.transpose();
        let move_back = |plane: &DVec4| {
            let normal = plane.truncate();
            (normals * normal).extend(normal.dot(world_from_frame.translation) + plane.w)
        };
        let local = LocalPolytope {
            planes: view.planes.iter().map(move_back).collect(),
            reference: move_back(&view.reference),
        };
        let is_finite = local.planes.iter().chain([&local.reference]).all(|p| p.is_finite());
        (is_finite && !local.planes.is_empty()).then_some(local)
    }

    fn window(&self) -> Option<WindowView> {
        self.views.first()?.in_eye.map(|(_, window)| window)
    }

    fn open_view(&mut self, view: &WindowView) -> Option<u32> {
        let seen = PolytopeView::seen(self.at?, view, false)?;
        self.views.push(seen);
        u32::try_from(self.views.len() - 1).ok()
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
    /// Returns the smallest distance from the reference plane of a volume around a centre; `None` if it is outside of a plane.
    fn enters(&self, center: DVec3, reach: impl Fn(DVec3) -> f64) -> Option<f64> {
        let nearest = |p: &DVec4, sign: f64| p.truncate().dot(center) + p.w + sign * reach(p.truncate());
        let is_met = self.planes.iter().all(|p| nearest(p, 1.0) >= 0.0);
        is_met.then(|| nearest(&self.reference, -1.0))
    }
}

impl Intersect for PolytopeIntersector {
    fn clear(&mut self) {
        self.views.truncate(1);
        self.met.clear();
        self.intersections.clear();
    }

    fn is_done(&self, candidate: &Candidate) -> bool {
        self.limit.is_reached(self.met.first(), candidate)
    }

    fn meet(&mut self, candidate: &Candidate, surface: &Surface) {
        let Some(local) = self.local(candidate.view, &candidate.world_from_drawable) else { return };
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
            let given = |distance_m: f64| match candidate.view {
                0 => distance_m,
                view => self.given_distance(view as usize, distance_m),
            };
            let new = Met {
                candidate: *candidate,
                primitive: primitive.number,
                vertices: primitive.vertices,
                weights: weights_of(primitive, local_point),
                ratio: given(cut.iter().map(distance).fold(f64::INFINITY, f64::min)),
                max_ratio: given(cut.iter().map(distance).fold(f64::NEG_INFINITY, f64::max)),
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

/// Clips a convex polygon, segment or point to the positive side of a plane. Sutherland and Hodgman, 1974.
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

/// Returns the weights of a primitive's corners at one of its points.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Drawable, IntersectionVisitor, Material, Mesh, MeshVertex, Node, Page, Scene, Topology};

    #[test]
    fn only_the_wanted_dimensions_are_met() {
        let drawable = |topology, indices: Vec<u32>| {
            let corners = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|corner| corner.as_vec3().to_array());
            let vertices = corners.map(|position| MeshVertex { position, ..MeshVertex::default() }).to_vec();
            Drawable::new(Mesh::new(vertices, indices, topology).into(), Material::default())
        };
        let drawables = vec![
            drawable(Topology::Points, vec![0]),
            drawable(Topology::Lines, vec![0, 1]),
            drawable(Topology::Triangles, vec![0, 1, 2]),
        ];
        let mut scene = Scene::new();
        scene.add_root(Page::from_node(Node::geode(drawables)).unwrap());
        let none = Dimensions { points: false, lines: false, triangles: false };
        for (dimensions, expected) in [
            (Dimensions { points: true, ..none }, vec![0]),
            (Dimensions { lines: true, ..none }, vec![1]),
            (Dimensions { triangles: true, ..none }, vec![2]),
            (Dimensions { triangles: false, ..Dimensions::ALL }, vec![0, 1]),
            (none, vec![]),
        ] {
            let polytope = PolytopeIntersector::in_box(DVec3::splat(-2.0), DVec3::splat(2.0));
            let mut polytope = polytope.with_dimensions(dimensions);
            IntersectionVisitor::new().traverse(&scene, &mut polytope);
            let mut met: Vec<u32> = polytope.intersections().iter().map(|hit| hit.drawable).collect();
            met.sort_unstable();
            assert_eq!(met, expected, "{dimensions:?}");
        }
    }
}
