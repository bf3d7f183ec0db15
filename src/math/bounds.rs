//! Bounding volumes in f64: sphere, axis-aligned box, oriented box and geodetic region.

use glam::{DAffine3, DMat3, DVec3};

use super::{Ellipsoid, Geodetic};

/// A sphere; `radius_m < 0` means empty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingSphere {
    /// Centre, in the frame of the sphere's owner.
    pub center: DVec3,
    /// Radius in metres, negative when the sphere is empty.
    pub radius_m: f64,
}

impl BoundingSphere {
    /// The empty sphere.
    pub const EMPTY: Self = Self { center: DVec3::ZERO, radius_m: -1.0 };

    /// The sphere around all space, for nodes that must never be culled.
    pub const EVERYTHING: Self = Self { center: DVec3::ZERO, radius_m: f64::INFINITY };

    /// Creates a sphere from its centre and radius.
    pub const fn new(center: DVec3, radius_m: f64) -> Self {
        Self { center, radius_m }
    }

    /// Returns true if the sphere is empty.
    pub fn is_empty(&self) -> bool {
        self.radius_m < 0.0
    }

    /// Returns the smallest sphere around both.
    pub fn union(&self, other: &Self) -> Self {
        if self.is_empty() {
            return *other;
        }
        if other.is_empty() {
            return *self;
        }
        let offset = other.center - self.center;
        let distance = offset.length();
        if distance + other.radius_m <= self.radius_m {
            return *self;
        }
        if distance + self.radius_m <= other.radius_m {
            return *other;
        }
        let radius_m = 0.5 * (distance + self.radius_m + other.radius_m);
        Self { center: self.center + offset * ((radius_m - self.radius_m) / distance), radius_m }
    }

    /// Returns a sphere around the image of the sphere under an affine map: scaled by the largest stretch, and slightly larger
    /// if the map shears.
    pub fn transformed(&self, to_from: &DAffine3) -> Self {
        if self.is_empty() {
            return *self;
        }
        Self { center: to_from.transform_point3(self.center), radius_m: self.radius_m * max_scale(&to_from.matrix3) }
    }
}

/// Returns an upper bound of the factor by which a linear map stretches a vector; exact if its columns are orthogonal.
///
/// It is the root of the largest row sum of the columns' dot products, which bounds their eigenvalues (Gershgorin). The
/// length of the longest column would be too small for a rotation that is stretched.
pub(crate) fn max_scale(m: &DMat3) -> f64 {
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
    let [xy, xz, yz] = [x.dot(y).abs(), x.dot(z).abs(), y.dot(z).abs()];
    let rows = [x.length_squared() + xy + xz, y.length_squared() + xy + yz, z.length_squared() + xz + yz];
    rows[0].max(rows[1]).max(rows[2]).sqrt()
}

/// An axis-aligned box; empty when `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Lower corner.
    pub min: DVec3,
    /// Upper corner.
    pub max: DVec3,
}

impl Aabb {
    /// The empty box.
    pub const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// Returns the box around points; NaN coordinates are ignored.
    pub fn from_points(points: impl IntoIterator<Item = DVec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, Self::with)
    }

    /// Returns the box around this box and a point; NaN coordinates are ignored.
    #[inline]
    pub(crate) fn with(self, point: DVec3) -> Self {
        // `min` and `max` return their second operand if the first is NaN.
        Self { min: point.min(self.min), max: point.max(self.max) }
    }

    /// Returns true if the box is empty.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Returns the centre of the box.
    pub fn center(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// Returns the eight corners.
    pub fn corners(&self) -> [DVec3; 8] {
        [0, 1, 2, 3, 4, 5, 6, 7].map(|i: u32| {
            let pick = |bit: u32, min: f64, max: f64| if i >> bit & 1 == 0 { min } else { max };
            DVec3::new(
                pick(0, self.min.x, self.max.x),
                pick(1, self.min.y, self.max.y),
                pick(2, self.min.z, self.max.z),
            )
        })
    }

    /// Returns half the extent along each axis.
    pub fn half_size(&self) -> DVec3 {
        0.5 * (self.max - self.min)
    }

    /// Returns the smallest box around both.
    pub fn union(&self, other: &Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Returns the axis-aligned box around the image of this box under an affine map.
    pub fn transformed(&self, to_from: &DAffine3) -> Self {
        if self.is_empty() {
            return *self;
        }
        let center = to_from.transform_point3(self.center());
        let half = self.half_size();
        let m = &to_from.matrix3;
        let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
        Self { min: center - reach, max: center + reach }
    }

    /// Returns the sphere around the box.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        if self.is_empty() {
            BoundingSphere::EMPTY
        } else {
            BoundingSphere::new(self.center(), self.half_size().length())
        }
    }
}

/// A box with its own axes: 3D Tiles' `box`. The half axes may have zero length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientedBox {
    /// Centre of the box.
    pub center: DVec3,
    /// Columns are the half axes, in metres.
    pub half_axes: DMat3,
}

impl OrientedBox {
    /// Returns the sphere around the box; infinite if an axis is NaN.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        let m = &self.half_axes;
        if m.is_nan() {
            return BoundingSphere::new(self.center, f64::INFINITY);
        }
        // The farthest corner; the axes need not be orthogonal.
        let mut radius_m = 0.0f64;
        for (sy, sz) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            radius_m = radius_m.max((m.x_axis + sy * m.y_axis + sz * m.z_axis).length());
        }
        BoundingSphere::new(self.center, radius_m)
    }

    /// Returns the axis-aligned box around the box.
    pub fn aabb(&self) -> Aabb {
        let m = &self.half_axes;
        let reach = m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs();
        Aabb { min: self.center - reach, max: self.center + reach }
    }

    /// Returns the image of the box under an affine map.
    pub fn transformed(&self, to_from: &DAffine3) -> Self {
        Self { center: to_from.transform_point3(self.center), half_axes: to_from.matrix3 * self.half_axes }
    }

    /// Returns the distance in metres from a point to the nearest point of the box; 0 inside. The axes must be orthogonal.
    pub fn distance_to(&self, point: DVec3) -> f64 {
        let offset = point - self.center;
        let m = &self.half_axes;
        let mut outside = 0.0;
        let mut rest = offset;
        for axis in [m.x_axis, m.y_axis, m.z_axis] {
            let length = axis.length();
            if length > 1e-12 {
                let direction = axis / length;
                let along = offset.dot(direction);
                rest -= direction * along;
                let excess = (along.abs() - length).max(0.0);
                outside += excess * excess;
            }
        }
        // The remainder lies along axes of zero length.
        (outside + rest.length_squared()).sqrt()
    }
}

/// The angle in radians over which the earth's surface bulges by a metre beyond its chord.
const SAMPLE_STEP: f64 = 1.1e-3;
/// The maximum number of samples along a side of a region.
const MAX_SAMPLES: u32 = 8;

/// A geodetic box: 3D Tiles' `region`. Radians and metres above the ellipsoid of its set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Western edge in radians; may be larger than `east` across the antimeridian.
    pub west: f64,
    /// Southern edge in radians.
    pub south: f64,
    /// Eastern edge in radians.
    pub east: f64,
    /// Northern edge in radians.
    pub north: f64,
    /// Lowest height in metres.
    pub min_height_m: f64,
    /// Highest height in metres.
    pub max_height_m: f64,
    /// The ellipsoid that the angles and heights refer to.
    pub ellipsoid: Ellipsoid,
}

impl Region {
    /// Returns the extent in longitude in radians, also across the antimeridian.
    pub fn width(&self) -> f64 {
        let w = self.east - self.west;
        if w < 0.0 { w + std::f64::consts::TAU } else { w }
    }

    /// Returns the centre of the region in longitude, latitude and height.
    pub fn center(&self) -> Geodetic {
        Geodetic {
            longitude: self.west + 0.5 * self.width(),
            latitude: 0.5 * (self.south + self.north),
            height_m: 0.5 * (self.min_height_m + self.max_height_m),
        }
    }

    /// Returns an oriented box (east, north, up at the centre) around the region, in ECEF metres.
    pub fn oriented_box(&self) -> OrientedBox {
        let extent = self.width().max(self.north - self.south);
        // The fewest samples whose hull is within a metre of the surface.
        let steps = ((extent / SAMPLE_STEP).ceil() as u32).clamp(1, MAX_SAMPLES);
        let at = |i: u32, j: u32, height_m| Geodetic {
            longitude: self.west + self.width() * f64::from(i) / f64::from(steps),
            latitude: self.south + (self.north - self.south) * f64::from(j) / f64::from(steps),
            height_m,
        };
        let samples = (0..=steps).flat_map(|i| (0..=steps).map(move |j| (i, j)));
        let samples = samples.flat_map(|(i, j)| [self.min_height_m, self.max_height_m].map(|height| at(i, j, height)));
        // Near a pole a degree of longitude is short. A chord of a parallel of radius r bulges by r times the square of its angle.
        let widest = if self.south * self.north < 0.0 { 1.0 } else { self.south.abs().min(self.north.abs()).cos() };
        let extent = (self.width() * widest.max(0.0).sqrt()).max(self.north - self.south);
        surface_box(&self.ellipsoid, &self.center(), samples, extent / f64::from(steps))
    }
}

/// The ratio of radii up to which the boxes around parts of a surface have room for its flattening.
const MAX_ROUND_RATIO: f64 = 1.01;

/// Returns an oriented box (east, north, up at `center`) around a part of an ellipsoid's surface, ECEF metres. `samples` are
/// points of the part, at most the angle `step`, in radians, apart.
pub(crate) fn surface_box(
    ellipsoid: &Ellipsoid,
    center: &Geodetic,
    samples: impl Iterator<Item = Geodetic>,
    step: f64,
) -> OrientedBox {
    let ecef_from_enu = ellipsoid.ecef_from_enu(center);
    let enu_from_ecef = ecef_from_enu.inverse();
    let b = Aabb::from_points(samples.map(|sample| enu_from_ecef.transform_point3(ellipsoid.ecef(&sample))));
    // Between samples the surface bulges beyond the hull by at most the sagitta of one step.
    // The largest radius of curvature is that of the equator times the ratio, or its square.
    let ratio = ellipsoid.semi_major_m / ellipsoid.semi_minor_m;
    let ratio = ratio.max(ratio.recip());
    let stretch = if ratio > MAX_ROUND_RATIO { ratio * ratio } else { 1.0 };
    let bulge = ellipsoid.semi_major_m * stretch * step * step / 8.0;
    OrientedBox {
        center: ecef_from_enu.transform_point3(b.center()),
        half_axes: ecef_from_enu.matrix3 * DMat3::from_diagonal(b.half_size() + DVec3::splat(bulge)),
    }
}

/// A bounding volume of 3D Tiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoundingVolume {
    /// `sphere`.
    Sphere(BoundingSphere),
    /// `box`.
    Box(OrientedBox),
    /// `region`; always in ECEF, no transform applies.
    Region(Region),
}

impl BoundingVolume {
    /// Returns true if a point (in ECEF for a region) is inside or on the surface.
    pub fn contains(&self, point: DVec3) -> bool {
        match self {
            Self::Sphere(s) => s.center.distance(point) <= s.radius_m,
            Self::Box(b) => b.distance_to(point) <= 1e-9 * b.center.distance(point),
            Self::Region(r) => {
                let g = r.ellipsoid.geodetic(point);
                // A region that crosses the antimeridian continues beyond 180 degrees.
                let east = if r.east < r.west { r.east + std::f64::consts::TAU } else { r.east };
                let longitude = if g.longitude < r.west { g.longitude + std::f64::consts::TAU } else { g.longitude };
                longitude <= east
                    && (r.south..=r.north).contains(&g.latitude)
                    && (r.min_height_m..=r.max_height_m).contains(&g.height_m)
            }
        }
    }

    /// Returns the oriented box of a box or region; `None` for a sphere.
    pub fn oriented_box(&self) -> Option<OrientedBox> {
        match self {
            Self::Sphere(_) => None,
            Self::Box(b) => Some(*b),
            Self::Region(r) => Some(r.oriented_box()),
        }
    }

    /// Returns the sphere around the volume.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        match self {
            Self::Sphere(s) => *s,
            Self::Box(b) => b.bounding_sphere(),
            Self::Region(r) => r.oriented_box().bounding_sphere(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::*;
    use crate::math::WGS84;

    #[test]
    fn union_holds_both() {
        let a = BoundingSphere::new(DVec3::ZERO, 1.0);
        let b = BoundingSphere::new(DVec3::X * 4.0, 2.0);
        let u = a.union(&b);
        for s in [a, b] {
            assert!(u.center.distance(s.center) + s.radius_m <= u.radius_m + 1e-12);
        }
        assert_eq!(a.union(&BoundingSphere::EMPTY), a);
    }

    /// The longest column of a turn that is stretched is shorter than the stretch.
    #[test]
    fn a_sphere_under_any_map_holds_what_it_held() {
        let turned = DMat3::from_diagonal(DVec3::new(10.0, 1.0, 1.0)) * DMat3::from_rotation_z(0.25 * PI);
        let sheared = DMat3::from_cols(DVec3::X, DVec3::new(3.0, 1.0, 0.0), DVec3::new(-2.0, 0.5, 4.0));
        let map = |m| DAffine3 { matrix3: m, translation: DVec3::new(5.0, 6.0, 7.0) };
        for m in [turned, sheared, turned * sheared, DMat3::from_rotation_x(0.3), DMat3::ZERO] {
            let sphere = BoundingSphere::new(DVec3::new(1.0, 2.0, 3.0), 100.0);
            let under = sphere.transformed(&map(m));
            for (i, j) in (0..40).flat_map(|i| (0..20).map(move |j| (i, j))) {
                let (turn, rise) = (TAU * f64::from(i) / 40.0, PI * (f64::from(j) / 19.0 - 0.5));
                let way = DVec3::new(turn.cos() * rise.cos(), turn.sin() * rise.cos(), rise.sin());
                let reach = map(m).transform_point3(sphere.center + 100.0 * way).distance(under.center);
                assert!(reach <= under.radius_m * (1.0 + 1e-12), "{m}: {reach} {}", under.radius_m);
            }
        }
        let tight = BoundingSphere::new(DVec3::ZERO, 1.0).transformed(&map(turned)).radius_m;
        assert!((tight - 10.0).abs() < 1e-9, "{tight}");
        let turn = BoundingSphere::new(DVec3::ZERO, 1.0).transformed(&map(DMat3::from_rotation_x(0.3))).radius_m;
        assert!((turn - 1.0).abs() < 1e-12, "{turn}");
    }

    #[test]
    fn what_is_no_number_forgets_no_point() {
        let points = [-5.0, f64::NAN, 7.0, 8.0].map(|x| DVec3::new(x, 1.0, 2.0));
        let around = Aabb::from_points(points);
        assert_eq!((around.min, around.max), (DVec3::new(-5.0, 1.0, 2.0), DVec3::new(8.0, 1.0, 2.0)));
        assert!(Aabb::from_points([DVec3::NAN]).is_empty());
        let odd = OrientedBox { center: DVec3::ZERO, half_axes: DMat3::from_diagonal(DVec3::new(1.0, f64::NAN, 1.0)) };
        assert_eq!(odd.bounding_sphere().radius_m, f64::INFINITY);
    }

    #[test]
    fn distance_to_a_flat_box() {
        let b = OrientedBox { center: DVec3::ZERO, half_axes: DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0)) };
        assert!((b.distance_to(DVec3::new(0.0, 0.0, 3.0)) - 3.0).abs() < 1e-12);
        assert!((b.distance_to(DVec3::new(4.0, 5.0, 0.0)) - 5.0).abs() < 1e-12);
        assert_eq!(b.distance_to(DVec3::new(0.5, -0.5, 0.0)), 0.0);
    }

    #[test]
    fn a_region_lies_in_its_box() {
        let r = Region {
            west: 0.1,
            south: 0.7,
            east: 0.2,
            north: 0.8,
            min_height_m: -10.0,
            max_height_m: 3000.0,
            ellipsoid: WGS84,
        };
        let b = r.oriented_box();
        for i in 0..=33 {
            for j in 0..=33 {
                for height_m in [-10.0, 3000.0] {
                    let p = WGS84.ecef(&Geodetic {
                        longitude: 0.1 + 0.1 * i as f64 / 33.0,
                        latitude: 0.7 + 0.1 * j as f64 / 33.0,
                        height_m,
                    });
                    assert!(b.distance_to(p) < 1e-6);
                }
            }
        }
    }

    /// Regression: the box around twelve metres at a pole had 850 km.
    #[test]
    fn box_around_a_pole_is_as_large_as_its_region() {
        for (south, radius_m) in [(0.5 * PI - 2e-6, 12.8), (0.5 * PI - 0.1, 640_000.0)] {
            for is_south in [false, true] {
                let [south, north] = if is_south { [-0.5 * PI, -south] } else { [south, 0.5 * PI] };
                let (min_height_m, max_height_m) = (0.0, 10.0);
                let r = Region { west: -PI, south, east: PI, north, min_height_m, max_height_m, ellipsoid: WGS84 };
                let b = r.oriented_box();
                assert!(b.bounding_sphere().radius_m < 1.7 * radius_m, "{radius_m}: {}", b.bounding_sphere().radius_m);
                for i in 0..=40 {
                    let latitude = if is_south { north } else { south };
                    let longitude = -PI + TAU * f64::from(i) / 40.0;
                    let p = WGS84.ecef(&Geodetic { longitude, latitude, height_m: 10.0 });
                    assert!(b.distance_to(p) < 1e-6, "{longitude}: {}", b.distance_to(p));
                }
            }
        }
    }
}
