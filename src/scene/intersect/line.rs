//! Intersectors of segments and rays, for picking and for the ground below a camera. Any thread.

use glam::{DAffine3, DMat3, DVec2, DVec3};

use super::intersection::{Intersect, Intersection, IntersectionLimit, Intersector, Met};
use super::probe::{Candidate, Probe};
use super::surface::Surface;
use super::window::WindowView;
use crate::math::Ray;

/// The position in an image at which a line was given.
#[derive(Clone, Copy, Debug)]
enum At {
    /// A point, pixels.
    Point(DVec2),
    /// A segment between two points with depths.
    Segment(DVec3, DVec3),
}

/// The line of a view.
#[derive(Clone, Copy, Debug)]
struct LineView {
    /// The line in the world.
    ray: Ray,
    /// The line in eye space with the view, if it was given in an image.
    in_eye: Option<(Ray, WindowView)>,
}

/// The implementation of segments and rays.
#[derive(Clone, Debug)]
struct Line {
    /// The line as given, followed by those of other projections met in the last traversal.
    views: Vec<LineView>,
    at: Option<At>,
    limit: IntersectionLimit,
    met: Vec<Met>,
    intersections: Vec<Intersection>,
}

impl At {
    /// Returns the line of a view; for the first view it starts at the eye.
    fn seen(self, view: &WindowView, is_first: bool) -> Option<LineView> {
        let ray = match self {
            At::Point(at) => view.contains(at).then(|| view.line_at(at, is_first)).flatten()?,
            At::Segment(from, to) => {
                let is_in = view.contains(from.truncate()) && view.contains(to.truncate());
                let eye_at = |point: DVec3| view.eye_at(point.truncate(), point.z);
                is_in.then_some(Ray::segment(eye_at(from)?, eye_at(to)?))?
            }
        };
        Some(LineView { ray: ray.moved(&view.world_from_eye), in_eye: Some((ray, *view)) })
    }
}

impl Line {
    fn new(ray: Ray) -> Self {
        let views = vec![LineView { ray, in_eye: None }];
        Self { views, at: None, limit: IntersectionLimit::NoLimit, met: Vec::new(), intersections: Vec::new() }
    }

    fn at_window(view: &WindowView, at: At) -> Self {
        let nothing = Line::new(Ray::infinite(DVec3::NAN, DVec3::NAN));
        match at.seen(view, true) {
            Some(seen) => Self { views: vec![seen], at: Some(at), ..nothing },
            None => nothing,
        }
    }

    /// Returns the ratio up to which a candidate is searched.
    fn max_ratio(&self, candidate: &Candidate, ray: &Ray) -> f64 {
        match (self.limit, self.met.first()) {
            (IntersectionLimit::Nearest, Some(nearest))
                if candidate.view == 0 && candidate.layer == nearest.candidate.layer =>
            {
                nearest.ratio
            }
            _ => ray.max_ratio,
        }
    }

    /// Converts a ratio of another view to the position of equal depth along the line as given.
    fn given_ratio(&self, view: &LineView, ratio: f64) -> f64 {
        let given = self.views.first().and_then(|given| given.in_eye);
        let (Some((line, window)), Some((own, other))) = (given, view.in_eye) else { return ratio };
        let found = window.eye_of_other(&other, own.at(ratio));
        found.map_or(0.0, |(p, is_beyond)| {
            let there = (p - line.origin).dot(line.direction) / line.direction.length_squared();
            if is_beyond { there + ratio } else { there }
        })
    }

    fn meet(&mut self, candidate: &Candidate, surface: &Surface) {
        let Some(view) = self.views.get(candidate.view as usize).copied() else { return };
        let Some(local) = view.ray.moved_back(&candidate.world_from_drawable) else { return };
        let local = Ray { max_ratio: self.max_ratio(candidate, &view.ray), ..local };
        let (limit, before) = (self.limit, self.met.len());
        let mut met = std::mem::take(&mut self.met);
        surface.intersect_line(&local, |hit| {
            let ratio = if candidate.view == 0 { hit.ratio } else { self.given_ratio(&view, hit.ratio) };
            let new = Met {
                candidate: *candidate,
                primitive: hit.primitive,
                vertices: hit.vertices,
                weights: hit.weights,
                ratio,
                max_ratio: ratio,
                local_point: local.at(hit.ratio),
                local_normal: hit.normal,
            };
            let kept = match limit {
                IntersectionLimit::NoLimit => None,
                IntersectionLimit::OnePerDrawable => met.get_mut(before),
                IntersectionLimit::One | IntersectionLimit::Nearest => met.first_mut(),
            };
            match (kept, limit) {
                (Some(kept), _) => {
                    // Ties are broken by the primitive's index, independent of the order in the tree.
                    let over = new.candidate.layer.cmp(&kept.candidate.layer);
                    let order = over.then(new.ratio.total_cmp(&kept.ratio));
                    if order.then(new.primitive.cmp(&kept.primitive)).is_lt() {
                        *kept = new;
                    }
                }
                (None, _) => met.push(new),
            }
            match limit {
                IntersectionLimit::NoLimit => f64::INFINITY,
                IntersectionLimit::OnePerDrawable | IntersectionLimit::Nearest => hit.ratio,
                IntersectionLimit::One => f64::NEG_INFINITY,
            }
        });
        self.met = met;
    }
}

/// Implements the traits of intersectors through the field `line`.
macro_rules! intersects_as_line {
    ($intersector:ty) => {
        impl Probe for $intersector {
            type Local = Ray;

            fn local(&self, view: u32, world_from_frame: &DAffine3) -> Option<Ray> {
                let ray = self.line.views.get(view as usize)?.ray;
                ray.is_valid().then(|| ray.moved_back(world_from_frame)).flatten()
            }

            fn window(&self) -> Option<WindowView> {
                self.line.views.first()?.in_eye.map(|(_, window)| window)
            }

            fn open_view(&mut self, view: &WindowView) -> Option<u32> {
                let seen = self.line.at?.seen(view, false)?;
                self.line.views.push(seen);
                u32::try_from(self.line.views.len() - 1).ok()
            }

            fn enters_sphere(ray: &Ray, center: DVec3, radius_m: f64) -> Option<f64> {
                ray.enters_sphere(center, radius_m)
            }

            fn enters_box(ray: &Ray, center: DVec3, axes: &DMat3, half: DVec3) -> Option<f64> {
                ray.enters_oriented(center, axes, half)
            }
        }

        impl Intersect for $intersector {
            fn clear(&mut self) {
                self.line.views.truncate(1);
                self.line.met.clear();
                self.line.intersections.clear();
            }

            fn is_done(&self, candidate: &Candidate) -> bool {
                self.line.limit.is_reached(self.line.met.first(), candidate)
            }

            fn meet(&mut self, candidate: &Candidate, surface: &Surface) {
                self.line.meet(candidate, surface);
            }

            fn results(&mut self) -> (&mut Vec<Met>, &mut Vec<Intersection>) {
                (&mut self.line.met, &mut self.line.intersections)
            }
        }

        impl Intersector for $intersector {}

        impl $intersector {
            /// Sets which intersections are kept.
            pub fn with_limit(mut self, limit: IntersectionLimit) -> Self {
                self.line.limit = limit;
                self
            }

            /// Returns the intersections of the last traversal, nearest first.
            pub fn intersections(&self) -> &[Intersection] {
                &self.line.intersections
            }

            /// Returns the nearest intersection.
            pub fn first_intersection(&self) -> Option<&Intersection> {
                self.line.intersections.first()
            }

            /// Takes the intersections.
            pub fn take_intersections(&mut self) -> Vec<Intersection> {
                std::mem::take(&mut self.line.intersections)
            }
        }
    };
}

/// Intersects triangles with a segment between two points of the world; ratios are 0 at the start and 1 at the end.
#[derive(Clone, Debug)]
pub struct LineSegmentIntersector {
    line: Line,
}

impl LineSegmentIntersector {
    /// Creates a segment from `start` to `end`, metres in the world. It meets nothing if a point is not finite or both are equal.
    pub fn new(start: DVec3, end: DVec3) -> Self {
        Self { line: Line::new(Ray::segment(start, end)) }
    }

    /// Creates a segment between two points of an image, each in pixels with a depth. The depth is 1 at the near plane and 0 at
    /// the far plane; no segment can end infinitely far. It meets geometry of every projection that draws there and whose
    /// viewport contains both points; OSG's intersector in window coordinates.
    ///
    /// Ratios of other projections are converted to the position of equal depth along this segment. Geometry drawn over
    /// others comes first, whatever its ratio.
    pub fn at_window(view: &WindowView, from: DVec3, to: DVec3) -> Self {
        Self { line: Line::at_window(view, At::Segment(from, to)) }
    }
}

/// Intersects triangles with a ray from a point of the world; ratios are metres.
#[derive(Clone, Debug)]
pub struct RayIntersector {
    line: Line,
}

impl RayIntersector {
    /// Creates a ray from `start` (metres in the world) along `direction` of any length. It meets nothing if the start is not
    /// finite or the direction has length zero.
    pub fn new(start: DVec3, direction: DVec3) -> Self {
        Self { line: Line::new(Ray::infinite(start, direction.normalize_or_zero())) }
    }

    /// Creates a ray from the eye through a point of an image, pixels; see [`LineSegmentIntersector::at_window`].
    pub fn at_window(view: &WindowView, at_px: DVec2) -> Self {
        Self { line: Line::at_window(view, At::Point(at_px)) }
    }
}

intersects_as_line!(LineSegmentIntersector);
intersects_as_line!(RayIntersector);
