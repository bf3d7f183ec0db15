//! Shadow volumes of occluders: the planes behind which nothing is visible, and the tests of bounds against them. Culling
//! thread.
//!
//! A volume is the pyramid from the eye through the polygon's edges (a prism under parallel rays), cut off at the
//! polygon. It is computed in eye space in f64, moved into the frame where bounds are stored, and rounded there. The
//! volumes that hide most of the view are kept.

use std::f64::consts::PI;

use glam::{DAffine3, DMat4, DVec3, DVec4, Vec4};

use crate::cull::views::EyePlanes;
use crate::math::BoundingSphere;
use crate::scene::ConvexPlanarOccluder;

/// Polygons are clipped at this distance from the plane through the eye, metres.
const NEAREST_M: f64 = 1e-3;

/// The volumes of all occluders, in eye space. A point is inside a volume where all of its planes are positive.
#[derive(Debug, Default)]
pub(super) struct Occluders {
    planes: Vec<DVec4>,
    /// Each volume is followed by those of its holes.
    volumes: Vec<Volume>,
    /// Number of occluders used at once; the ones with the largest solid angle are kept.
    max_count: usize,
    /// Scratch memory: a polygon before and after clipping.
    corners: [Vec<DVec3>; 2],
}

/// A range of planes that bound a shadow, or the view through a hole in an occluder.
#[derive(Clone, Copy, Debug)]
struct Volume {
    /// First plane: that of the polygon itself, except for holes.
    first: u32,
    /// One past the last plane.
    end: u32,
    /// Number of volumes of holes that follow.
    holes: u32,
    /// Solid angle in steradians (square metres under parallel rays); 0 for holes.
    size: f64,
}

/// The planes of [`Occluders`] in another frame, as f32.
#[derive(Debug, Default)]
pub(super) struct FrameOccluders {
    planes: Vec<Vec4>,
}

/// The rays and the frustum of a view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    /// The direction of all rays in eye space where they are parallel; `None` where they start at the eye.
    along: Option<DVec3>,
    planes: EyePlanes,
}

impl Sight {
    /// Creates the sight of a projection.
    pub fn new(clip_from_eye: &DMat4, planes: EyePlanes) -> Self {
        let rows = clip_from_eye.transpose();
        // Points along this direction keep their x and y in the image.
        let along = rows.x_axis.truncate().cross(rows.y_axis.truncate()).try_normalize();
        let along = along.filter(|_| rows.w_axis.truncate() == DVec3::ZERO);
        Self { along: along.map(|d| if d.z > 0.0 { -d } else { d }), planes }
    }
}

impl Occluders {
    /// Removes all occluders and keeps the memory. At most `max_count` are used from now on.
    pub fn clear(&mut self, max_count: usize) {
        self.max_count = max_count;
        self.planes.clear();
        self.volumes.clear();
    }

    /// Returns true if there are no occluders.
    pub fn is_empty(&self) -> bool {
        self.volumes.is_empty()
    }

    /// Returns false if no occluder inside a sphere in eye space would be used: it is outside the frustum or too small.
    pub fn may_use(&self, sight: &Sight, sphere: &BoundingSphere) -> bool {
        let BoundingSphere { center, radius_m } = *sphere;
        if !radius_m.is_finite() {
            return true;
        }
        let is_behind = center.z - radius_m > -NEAREST_M;
        if is_behind || sight.planes.sphere_is_outside(center, radius_m) {
            return false;
        }
        let sine = radius_m / center.length();
        let max_size = match sight.along {
            Some(_) => PI * radius_m * radius_m,
            None if sine < 1.0 => 2.0 * PI * (1.0 - (1.0 - sine * sine).sqrt()),
            None => f64::INFINITY,
        };
        // Slightly enlarged against rounding.
        self.smallest().is_none_or(|(_, smallest)| max_size * (1.0 + 1e-9) + 1e-12 > smallest)
    }

    /// Adds an occluder if it is seen and there is space for it or it is larger than the smallest, which it then replaces.
    /// `is_shown` is costly and only called for an occluder that would be added.
    pub fn offer(
        &mut self,
        sight: &Sight,
        eye_from_node: &DAffine3,
        occluder: &ConvexPlanarOccluder,
        is_shown: impl FnOnce() -> bool,
    ) {
        if !self.clip(eye_from_node, &occluder.corners) || sight.planes.are_outside(&self.corners[1]) {
            return;
        }
        let Some(polygon) = Polygon::new(sight, &self.corners[1]) else { return };
        let size = polygon.size(sight, &self.corners[1]);
        let smallest = self.smallest();
        if size.is_nan() || size <= 0.0 || smallest.is_some_and(|(_, smallest)| size <= smallest) || !is_shown() {
            return;
        }
        if let Some((index, _)) = smallest {
            self.remove(index);
        }
        let index = self.volumes.len();
        self.add(sight, &polygon, Some(size));
        for hole in &occluder.holes {
            if self.clip(eye_from_node, hole)
                && let Some(polygon) = Polygon::new(sight, &self.corners[1])
            {
                self.add(sight, &polygon, None);
                self.volumes[index].holes += 1;
            }
        }
    }

    /// Moves a polygon to eye space and clips what is behind the eye. Returns false if nothing is left, or if a corner is
    /// not finite.
    fn clip(&mut self, eye_from_node: &DAffine3, corners: &[DVec3]) -> bool {
        let [given, clipped] = &mut self.corners;
        given.clear();
        given.extend(corners.iter().map(|c| eye_from_node.transform_point3(*c)));
        clipped.clear();
        for (i, a) in given.iter().enumerate() {
            let b = given[(i + 1) % given.len()];
            if a.z <= -NEAREST_M {
                clipped.push(*a);
            }
            if (a.z <= -NEAREST_M) != (b.z <= -NEAREST_M) {
                clipped.push(a.lerp(b, (-NEAREST_M - a.z) / (b.z - a.z)));
            }
        }
        clipped.len() >= 3 && clipped.iter().all(|c| c.is_finite())
    }

    /// Adds the planes of the clipped polygon as a volume: of an occluder with a size, otherwise of a hole.
    fn add(&mut self, sight: &Sight, polygon: &Polygon, size: Option<f64>) {
        let first = self.planes.len() as u32;
        if size.is_some() {
            self.planes.push(polygon.away.extend(-polygon.away.dot(polygon.middle)));
        }
        for (a, b) in edges(&self.corners[1]) {
            let side = sight.along.map_or_else(|| a.cross(b), |along| (b - a).cross(along));
            if let Some(side) = side.try_normalize() {
                let from = if sight.along.is_some() { a } else { DVec3::ZERO };
                let inward = if side.dot(polygon.middle - from) < 0.0 { -side } else { side };
                self.planes.push(inward.extend(-inward.dot(from)));
            }
        }
        let end = self.planes.len() as u32;
        self.volumes.push(Volume { first, end, holes: 0, size: size.unwrap_or(0.0) });
    }

    /// Returns index and size of the smallest occluder, which a larger one replaces; `None` while there is room.
    fn smallest(&self) -> Option<(usize, f64)> {
        let mut smallest = None;
        let (mut count, mut index) = (0, 0);
        while let Some(volume) = self.volumes.get(index) {
            if smallest.is_none_or(|(_, size)| volume.size < size) {
                smallest = Some((index, volume.size));
            }
            count += 1;
            index += 1 + volume.holes as usize;
        }
        smallest.filter(|_| count >= self.max_count)
    }

    /// Removes an occluder with its holes.
    fn remove(&mut self, index: usize) {
        let last = index + self.volumes[index].holes as usize;
        let (first, end) = (self.volumes[index].first, self.volumes[last].end);
        self.planes.drain(first as usize..end as usize);
        self.volumes.drain(index..=last);
        for after in &mut self.volumes[index..] {
            (after.first, after.end) = (after.first - (end - first), after.end - (end - first));
        }
    }

    /// Writes the planes in the frame of `eye_from_frame`, relative to a point of it.
    pub fn in_frame(&self, eye_from_frame: &DAffine3, origin: DVec3, into: &mut FrameOccluders) {
        into.planes.clear();
        let to_frame = eye_from_frame.matrix3.transpose();
        let origin_in_eye = eye_from_frame.transform_point3(origin);
        into.planes.extend(self.planes.iter().map(|p| {
            let normal = to_frame * p.truncate();
            let d = p.truncate().dot(origin_in_eye) + p.w;
            let length2 = normal.length_squared();
            // Most maps are rigid and keep the unit length, which saves the root and the divisions.
            if (length2 - 1.0).abs() < 1e-12 && d.is_finite() {
                return normal.extend(d).as_vec4();
            }
            let length = length2.sqrt();
            let plane = (normal / length).extend(d / length);
            // A plane that cannot be normalised hides nothing.
            if length > 0.0 && plane.is_finite() { plane.as_vec4() } else { Vec4::new(0.0, 0.0, 0.0, f32::MIN) }
        }));
    }

    /// Returns true if a bound lies wholly in the shadow of one occluder and is not seen through its holes. `reach` is
    /// the bound's extent along a direction.
    #[inline]
    pub fn hide(&self, frame: &FrameOccluders, center: [f32; 3], reach: impl Fn(Vec4) -> f32) -> bool {
        let distance = |p: Vec4| p.x * center[0] + p.y * center[1] + p.z * center[2] + p.w;
        let planes = |v: &Volume| &frame.planes[v.first as usize..v.end as usize];
        let mut rest = &self.volumes[..];
        while let Some((volume, after)) = rest.split_first() {
            let (holes, next) = after.split_at(volume.holes as usize);
            rest = next;
            let inside = |v: &Volume| planes(v).iter().all(|p| distance(*p) >= reach(*p));
            let outside = |v: &Volume| planes(v).iter().any(|p| distance(*p) < -reach(*p));
            if inside(volume) && holes.iter().all(outside) {
                return true;
            }
        }
        false
    }
}

/// Measures of a clipped polygon.
struct Polygon {
    middle: DVec3,
    /// Unit normal that points away from the eye.
    away: DVec3,
    area_m2: f64,
}

impl Polygon {
    /// Measures a polygon. Returns `None` if it is seen edge-on or has no area.
    fn new(sight: &Sight, corners: &[DVec3]) -> Option<Self> {
        let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
        let normal = edges(corners).map(|(a, b)| (a - middle).cross(b - middle)).sum::<DVec3>();
        let area_m2 = 0.5 * normal.length();
        let normal = normal.try_normalize()?;
        let ray = sight.along.unwrap_or(middle);
        let facing = normal.dot(ray);
        (facing.abs() >= 1e-9 * ray.length()).then_some(Self { middle, away: normal * facing.signum(), area_m2 })
    }

    /// Returns the size of the view that it hides: steradians, or square metres under parallel rays.
    fn size(&self, sight: &Sight, corners: &[DVec3]) -> f64 {
        if let Some(along) = sight.along {
            return self.area_m2 * self.away.dot(along);
        }
        // Solid angle of each triangle around the middle: Van Oosterom and Strackee 1983.
        let triangle = |(a, b): (DVec3, DVec3)| {
            let (a, b, c) = (a.normalize_or_zero(), b.normalize_or_zero(), self.middle.normalize_or_zero());
            let above = a.dot(b.cross(c)).abs();
            2.0 * above.atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
        };
        edges(corners).map(triangle).sum()
    }
}

/// Returns each corner with the next one.
fn edges(corners: &[DVec3]) -> impl Iterator<Item = (DVec3, DVec3)> + '_ {
    corners.iter().copied().zip(corners.iter().copied().cycle().skip(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn square(half: f64, z: f64) -> Vec<DVec3> {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x * half, y * half, z)).into()
    }

    const EVERYWHERE: Sight = Sight { along: None, planes: EyePlanes::NONE };

    fn hides(occluder: &ConvexPlanarOccluder, center: DVec3, radius: f32) -> bool {
        let mut occluders = Occluders { max_count: 16, ..Occluders::default() };
        occluders.offer(&EVERYWHERE, &DAffine3::IDENTITY, occluder, || true);
        let mut frame = FrameOccluders::default();
        occluders.in_frame(&DAffine3::IDENTITY, DVec3::ZERO, &mut frame);
        occluders.hide(&frame, center.as_vec3().to_array(), |_| radius)
    }

    #[test]
    fn bounds_behind_an_occluder_are_hidden_unless_seen_through_a_hole() {
        let wall = ConvexPlanarOccluder { corners: square(1.0, -10.0), holes: vec![] };
        let at = |x: f64, z: f64| DVec3::new(x, 0.0, z);
        assert!(hides(&wall, at(0.0, -20.0), 1.0));
        assert!(!hides(&wall, at(0.0, -5.0), 1.0), "before it");
        assert!(!hides(&wall, at(0.0, -10.5), 1.0), "across it");
        assert!(!hides(&wall, at(1.5, -20.0), 1.0), "partly beside it");
        assert!(!hides(&wall, at(0.0, 20.0), 1.0), "behind the eye");
        let holed = ConvexPlanarOccluder { corners: square(1.0, -10.0), holes: vec![square(0.2, -10.0)] };
        assert!(!hides(&holed, at(0.0, -20.0), 0.1), "seen through the hole");
        assert!(hides(&holed, at(1.2, -20.0), 0.1), "beside the hole");
        let behind = ConvexPlanarOccluder { corners: square(1.0, 10.0), holes: vec![] };
        assert!(!hides(&behind, at(0.0, -20.0), 1.0));
        let invalid = ConvexPlanarOccluder { corners: vec![DVec3::NAN; 4], holes: vec![] };
        assert!(!hides(&invalid, at(0.0, -20.0), 1.0));
    }

    #[test]
    fn only_the_largest_occluders_are_used() {
        let mut occluders = Occluders { max_count: 16, ..Occluders::default() };
        let mut asked = 0;
        for i in (0..40).chain(0..30) {
            let occluder = ConvexPlanarOccluder {
                corners: square(1.0 + f64::from(i), -100.0),
                holes: vec![square(0.1, -100.0); (i % 3) as usize],
            };
            let is_shown = || {
                asked += 1;
                i != 35
            };
            occluders.offer(&EVERYWHERE, &DAffine3::IDENTITY, &occluder, is_shown);
        }
        let sizes: Vec<f64> = occluders.volumes.iter().map(|v| v.size).filter(|s| *s > 0.0).collect();
        assert_eq!(sizes.len(), 16);
        // Kept are the half sizes 25 to 40 without 36, and 30 a second time.
        assert_eq!(asked, 40 + 6, "visibility is only checked for occluders that are large enough");
        let smallest = sizes.iter().copied().fold(f64::INFINITY, f64::min);
        assert!((smallest - 4.0 * (0.25f64 * 0.25 / (1.0 + 0.25 * 0.25)).asin()).abs() < 0.05, "{smallest}");
        // The planes of removed occluders are gone; the others are contiguous.
        let kept: u32 = occluders.volumes.iter().map(|v| v.end - v.first).sum();
        assert_eq!(occluders.planes.len(), kept as usize);
        let mut end = 0;
        for volume in &occluders.volumes {
            assert_eq!(std::mem::replace(&mut end, volume.end), volume.first);
            assert_eq!(volume.end - volume.first, if volume.size > 0.0 { 5 } else { 4 });
        }
    }

    #[test]
    fn sizes_are_solid_angles() {
        let size = |corners: &[DVec3]| Polygon::new(&EVERYWHERE, corners).unwrap().size(&EVERYWHERE, corners);
        // A face of a cube around the eye covers a sixth of the sphere.
        assert!((size(&square(5.0, -5.0)) - 4.0 * std::f64::consts::PI / 6.0).abs() < 1e-9);
        let away = |x: f64| square(1.0, -10.0).iter().map(|c| *c + DVec3::X * x).collect::<Vec<_>>();
        assert!((size(&away(0.0)) - 0.04).abs() < 1e-3 && size(&away(10.0)) < 0.5 * size(&away(0.0)));
    }

    #[test]
    fn parallel_rays_make_a_prism() {
        let wall = ConvexPlanarOccluder { corners: square(1.0, -10.0), holes: vec![square(0.2, -10.0)] };
        let hides = |clip_from_eye: DMat4, x: f64, z: f64| {
            let sight = Sight::new(&clip_from_eye, EyePlanes::NONE);
            let mut occluders = Occluders { max_count: 16, ..Occluders::default() };
            occluders.offer(&sight, &DAffine3::IDENTITY, &wall, || true);
            let mut frame = FrameOccluders::default();
            occluders.in_frame(&DAffine3::IDENTITY, DVec3::ZERO, &mut frame);
            occluders.hide(&frame, [x as f32, 0.0, z as f32], |_| 0.25)
        };
        use glam::dcamera::rh::proj::directx as proj;
        let parallel = proj::orthographic(-5.0, 5.0, -5.0, 5.0, 100.0, 0.1);
        let from_eye = proj::perspective_infinite_reverse(1.0, 1.0, 0.1);
        assert!(hides(parallel, 0.6, -30.0) && hides(from_eye, 1.8, -30.0));
        assert!(!hides(parallel, 1.8, -30.0), "beside it");
        assert!(!hides(parallel, 0.0, -30.0) && !hides(from_eye, 0.6, -30.0), "through the hole");
        assert!(!hides(parallel, 0.6, -5.0) && !hides(parallel, 0.6, 30.0));
        // Oblique rays: one metre to the right for each metre of depth.
        let oblique = parallel * DMat4::from_cols(DVec4::X, DVec4::Y, DVec4::new(1.0, 0.0, 1.0, 0.0), DVec4::W);
        assert!(hides(oblique, 20.6, -30.0) && !hides(oblique, 0.6, -30.0));
    }

    proptest! {
        #[test]
        fn no_point_of_a_hidden_ball_is_seen(
            corners in prop::array::uniform3((-8.0..8.0f64, -8.0..8.0f64)),
            tilt in -0.6..0.6f64,
            center in (-20.0..20.0f64, -20.0..20.0f64, -60.0..10.0f64),
            radius in 0.01..3.0f64,
            toward in (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64),
        ) {
            let z = |x: f64| -12.0 + tilt * x;
            let corners: Vec<DVec3> = corners.iter().map(|(x, y)| DVec3::new(*x, *y, z(*x))).collect();
            let center = DVec3::new(center.0, center.1, center.2);
            let occluder = ConvexPlanarOccluder { corners: corners.clone(), holes: vec![] };
            if hides(&occluder, center, radius as f32) {
                // The ray to every point of the ball hits the triangle first.
                let direction = DVec3::new(toward.0, toward.1, toward.2).normalize_or(DVec3::X);
                let point = center + 0.999 * radius * direction;
                let (a, b, c) = (corners[0], corners[1], corners[2]);
                let normal = (b - a).cross(c - a);
                let t = normal.dot(a) / normal.dot(point);
                prop_assert!(t > 0.0 && t < 1.0 + 1e-6, "in front of it: {t}");
                let hit = point * t;
                let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| (q - p).cross(hit - p).dot(normal));
                let slack = 1e-3 * normal.length();
                prop_assert!(sides.iter().all(|s| *s >= -slack), "beside it: {sides:?}");
            }
        }
    }
}
