//! Intersections with segments and rays.

use glam::{DAffine3, DMat3, DVec2, DVec3};

use super::intersection::{Intersect, Intersection, IntersectionLimit, Intersector, Met};
use super::probe::{Candidate, Probe};
use super::surface::Surface;
use super::window::WindowView;
use crate::math::Ray;

/// Where in a picture a line was given.
#[derive(Clone, Copy, Debug)]
enum At {
    /// A place, pixels.
    Place(DVec2),
    /// From one place and depth to another.
    Segment(DVec3, DVec3),
}

/// The line as a view has it.
#[derive(Clone, Copy, Debug)]
struct LineView {
    /// In the world.
    ray: Ray,
    /// In eye space, of one that was given in a picture, with the picture.
    in_eye: Option<(Ray, WindowView)>,
}

/// What segments and rays share.
#[derive(Clone, Debug)]
struct Line {
    /// As it was given, and below other projections of the last traversal.
    views: Vec<LineView>,
    at: Option<At>,
    limit: IntersectionLimit,
    met: Vec<Met>,
    intersections: Vec<Intersection>,
}

impl At {
    /// As a view has it; of the first one all from the eye on.
    fn seen(self, view: &WindowView, is_first: bool) -> Option<LineView> {
        let ray = match self {
            At::Place(at) => view.contains(at).then(|| view.line_at(at, is_first)).flatten()?,
            At::Segment(from, to) => {
                let is_in = view.contains(from.truncate()) && view.contains(to.truncate());
                let eye_at = |place: DVec3| view.eye_at(place.truncate(), place.z);
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

    fn is_done(&self, candidate: &Candidate) -> bool {
        match (self.limit, self.met.first()) {
            (IntersectionLimit::Nearest, Some(nearest)) => {
                candidate.layer > nearest.candidate.layer
                    || candidate.layer == nearest.candidate.layer && candidate.enters > nearest.ratio
            }
            (IntersectionLimit::One, Some(_)) => true,
            _ => false,
        }
    }

    /// Up to where more of a candidate is looked for.
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

    /// Where what another view meets at a ratio would be along the line as it was given.
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
                    // Of two at the same place the one with the lower number, whatever the tree's order is.
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

/// Implements the traversal's traits through the field `line`.
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
                self.line.is_done(candidate)
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
            /// The same, keeping other intersections.
            pub fn with_limit(mut self, limit: IntersectionLimit) -> Self {
                self.line.limit = limit;
                self
            }

            /// What the last traversal met, nearest first.
            pub fn intersections(&self) -> &[Intersection] {
                &self.line.intersections
            }

            /// The nearest one.
            pub fn first_intersection(&self) -> Option<&Intersection> {
                self.line.intersections.first()
            }

            /// Takes them out.
            pub fn take_intersections(&mut self) -> Vec<Intersection> {
                std::mem::take(&mut self.line.intersections)
            }
        }
    };
}

/// Meets triangles between two points of the world; ratios are 0 at the start and 1 at the end.
#[derive(Clone, Debug)]
pub struct LineSegmentIntersector {
    line: Line,
}

impl LineSegmentIntersector {
    /// From `start` to `end`, metres in the world. Points that are not finite, or are the same, meet nothing.
    pub fn new(start: DVec3, end: DVec3) -> Self {
        Self { line: Line::new(Ray::segment(start, end)) }
    }

    /// Between two places of a picture, each in pixels with a depth (1 at the near plane, 0 at the far plane or
    /// infinitely far, where nothing can end), under every projection that draws there; OSG's intersector in window
    /// coordinates. Both must be in the viewport of what is met.
    ///
    /// Of what other projections draw, the ratio is where it would be along the line in the picture itself, were it there
    /// at the same depth; what is drawn over others comes first whatever the ratio.
    pub fn at_window(view: &WindowView, from: DVec3, to: DVec3) -> Self {
        Self { line: Line::at_window(view, At::Segment(from, to)) }
    }
}

/// Meets triangles from a point of the world on without end; ratios are metres.
#[derive(Clone, Debug)]
pub struct RayIntersector {
    line: Line,
}

impl RayIntersector {
    /// From `start` (metres in the world) along `direction` of any length. A start that is not finite, or a direction of
    /// length zero, meets nothing.
    pub fn new(start: DVec3, direction: DVec3) -> Self {
        Self { line: Line::new(Ray::infinite(start, direction.normalize_or_zero())) }
    }

    /// All that shows at a place of a picture, pixels, from the eye on; see [`LineSegmentIntersector::at_window`].
    pub fn at_window(view: &WindowView, at_px: DVec2) -> Self {
        Self { line: Line::at_window(view, At::Place(at_px)) }
    }
}

intersects_as_line!(LineSegmentIntersector);
intersects_as_line!(RayIntersector);
