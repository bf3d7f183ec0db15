//! Rays and segments in f64, and their intersection with bounds.

use glam::{DAffine3, DMat3, DVec3};

/// Points `origin + ratio * direction` with `0 <= ratio <= max_ratio`: a segment, or a ray where `max_ratio` is infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// The start, metres.
    pub origin: DVec3,
    /// The vector from ratio 0 to ratio 1, of any length.
    pub direction: DVec3,
    /// The ratio of the end.
    pub max_ratio: f64,
}

impl Ray {
    /// Creates the segment from one point (ratio 0) to another (ratio 1).
    pub fn segment(start: DVec3, end: DVec3) -> Self {
        Self { origin: start, direction: end - start, max_ratio: 1.0 }
    }

    /// Creates a ray without an end.
    pub fn infinite(origin: DVec3, direction: DVec3) -> Self {
        Self { origin, direction, max_ratio: f64::INFINITY }
    }

    /// Returns the point at a ratio.
    pub fn at(&self, ratio: f64) -> DVec3 {
        self.origin + self.direction * ratio
    }

    /// Returns false if a coordinate is NaN or infinite, or if the direction is zero: such a ray hits nothing.
    pub fn is_valid(&self) -> bool {
        self.origin.is_finite() && self.direction.is_finite() && self.direction != DVec3::ZERO && self.max_ratio >= 0.0
    }

    /// Returns the ray in another frame, with the same ratios.
    pub fn moved(&self, to_from: &DAffine3) -> Self {
        Self {
            origin: to_from.transform_point3(self.origin),
            direction: to_from.matrix3 * self.direction,
            max_ratio: self.max_ratio,
        }
    }

    /// Returns the ray in the source frame of `from_to`, or `None` if the map has no inverse. The translation is subtracted
    /// first, so that planetary coordinates keep their precision.
    pub fn moved_back(&self, from_to: &DAffine3) -> Option<Self> {
        let inverse = from_to.matrix3.inverse();
        let moved = Self {
            origin: inverse * (self.origin - from_to.translation),
            direction: inverse * self.direction,
            max_ratio: self.max_ratio,
        };
        moved.is_valid().then_some(moved)
    }

    /// Returns the least ratio inside a sphere, or `None` if it misses.
    pub fn enters_sphere(&self, center: DVec3, radius_m: f64) -> Option<f64> {
        let to_center = center - self.origin;
        let length_squared = self.direction.length_squared();
        let nearest = to_center.dot(self.direction) / length_squared;
        let off = to_center - self.direction * nearest;
        let half_squared = (radius_m * radius_m - off.length_squared()) / length_squared;
        if half_squared < 0.0 || half_squared.is_nan() {
            return None;
        }
        let half = half_squared.sqrt();
        let enter = (nearest - half).max(0.0);
        (enter <= (nearest + half).min(self.max_ratio)).then_some(enter)
    }

    /// Returns the least ratio inside an axis-aligned box, or `None` if it misses.
    pub fn enters_box(&self, center: DVec3, half: DVec3) -> Option<f64> {
        self.enters(self.origin - center, self.direction, half)
    }

    /// Returns the least ratio inside a box whose unit axes are the columns of `axes`, or `None` if it misses.
    pub fn enters_oriented(&self, center: DVec3, axes: &DMat3, half: DVec3) -> Option<f64> {
        let box_from_frame = axes.transpose();
        self.enters(box_from_frame * (self.origin - center), box_from_frame * self.direction, half)
    }

    fn enters(&self, origin: DVec3, direction: DVec3, half: DVec3) -> Option<f64> {
        let (first, last) = slab(origin, direction, -half, half);
        let (first, last) = (first.max(0.0), last.min(self.max_ratio));
        (first <= last).then_some(first)
    }
}

/// Returns the ratios between which a line is inside the box between two corners. The first is larger if it misses.
pub(crate) fn slab(origin: DVec3, direction: DVec3, min: DVec3, max: DVec3) -> (f64, f64) {
    let (mut first, mut last) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (o, d) = (origin[axis], direction[axis]);
        if d == 0.0 {
            if !(min[axis]..=max[axis]).contains(&o) {
                return (f64::INFINITY, f64::NEG_INFINITY);
            }
        } else {
            let (a, b) = ((min[axis] - o) / d, (max[axis] - o) / d);
            first = first.max(a.min(b));
            last = last.min(a.max(b));
        }
    }
    (first, last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ray_enters_bounds_before_it() {
        let ray = Ray::infinite(DVec3::new(-10.0, 0.0, 0.0), DVec3::X * 2.0);
        assert_eq!(ray.enters_sphere(DVec3::ZERO, 2.0), Some(4.0));
        assert_eq!(ray.enters_sphere(DVec3::new(-20.0, 0.0, 0.0), 2.0), None, "behind it");
        assert_eq!(ray.enters_sphere(DVec3::new(-10.0, 0.5, 0.0), 2.0), Some(0.0), "from inside");
        assert_eq!(ray.enters_box(DVec3::ZERO, DVec3::ONE), Some(4.5));
        assert_eq!(ray.enters_box(DVec3::Y * 3.0, DVec3::ONE), None);
        let axes = DMat3::from_rotation_z(std::f64::consts::FRAC_PI_4);
        let enters = ray.enters_oriented(DVec3::ZERO, &axes, DVec3::ONE).unwrap();
        assert!((enters - 0.5 * (10.0 - 2f64.sqrt())).abs() < 1e-12);
    }

    #[test]
    fn segment_ends_at_its_ratio() {
        let segment = Ray::segment(DVec3::ZERO, DVec3::X);
        assert_eq!(segment.enters_sphere(DVec3::X * 3.0, 1.5), None);
        assert_eq!(segment.enters_box(DVec3::X * 3.0, DVec3::splat(2.0)), Some(1.0));
        assert!(!Ray::segment(DVec3::X, DVec3::X).is_valid());
        assert!(!Ray::infinite(DVec3::NAN, DVec3::X).is_valid());
    }

    #[test]
    fn planetary_coordinates_keep_their_precision() {
        let place = DVec3::new(4_201_000.3, 168_000.7, 4_780_000.1);
        let map = DAffine3 { matrix3: DMat3::from_rotation_x(0.7), translation: place };
        let local = Ray::segment(place + map.matrix3 * DVec3::Z, place).moved_back(&map).unwrap();
        assert!(local.origin.distance(DVec3::Z) < 2e-9, "{}", local.origin);
    }
}
