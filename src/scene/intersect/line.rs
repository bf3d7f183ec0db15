//! Intersections with segments and rays.

use glam::{DAffine3, DMat3, DVec3};

use super::surface::Surface;
use super::visitor::{Intersect, Intersection, IntersectionLimit, Intersector, Met};
use super::walk::{Candidate, Probe};
use crate::math::Ray;

/// What segments and rays share.
#[derive(Clone, Debug)]
struct Line {
    ray: Ray,
    limit: IntersectionLimit,
    met: Vec<Met>,
    intersections: Vec<Intersection>,
}

impl Line {
    fn new(ray: Ray, limit: IntersectionLimit) -> Self {
        Self { ray, limit, met: Vec::new(), intersections: Vec::new() }
    }

    /// Up to where more is looked for.
    fn max_ratio(&self) -> f64 {
        match (self.limit, self.met.first()) {
            (IntersectionLimit::Nearest, Some(nearest)) => nearest.ratio,
            _ => self.ray.max_ratio,
        }
    }

    fn is_done(&self, enters: f64) -> bool {
        match self.limit {
            IntersectionLimit::Nearest => enters > self.max_ratio(),
            IntersectionLimit::One => !self.met.is_empty(),
            IntersectionLimit::NoLimit | IntersectionLimit::OnePerDrawable => false,
        }
    }

    fn meet(&mut self, candidate: &Candidate, surface: &Surface) {
        let Some(local) = self.ray.moved_back(&candidate.world_from_drawable) else { return };
        let local = Ray { max_ratio: self.max_ratio(), ..local };
        let (limit, before) = (self.limit, self.met.len());
        let met = &mut self.met;
        surface.intersect_line(&local, |hit| {
            let new = Met {
                candidate: *candidate,
                primitive: hit.primitive,
                vertices: hit.vertices,
                weights: hit.weights,
                ratio: hit.ratio,
                max_ratio: hit.ratio,
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
                    let order = new.ratio.total_cmp(&kept.ratio).then(new.primitive.cmp(&kept.primitive));
                    if order.is_lt() {
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
    }
}

/// Implements the traversal's traits through the field `line`.
macro_rules! intersects_as_line {
    ($intersector:ty) => {
        impl Probe for $intersector {
            type Local = Ray;

            fn local(&self, world_from_frame: &DAffine3) -> Option<Ray> {
                self.line.ray.is_valid().then(|| self.line.ray.moved_back(world_from_frame)).flatten()
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
                self.line.met.clear();
                self.line.intersections.clear();
            }

            fn is_done(&self, enters: f64) -> bool {
                self.line.is_done(enters)
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
        Self { line: Line::new(Ray::segment(start, end), IntersectionLimit::NoLimit) }
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
        Self { line: Line::new(Ray::infinite(start, direction.normalize_or_zero()), IntersectionLimit::NoLimit) }
    }
}

intersects_as_line!(LineSegmentIntersector);
intersects_as_line!(RayIntersector);
