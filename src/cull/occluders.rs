//! Shadow volumes of OccluderNodes, collected before a cull: what lies wholly inside one is not seen.
//!
//! A volume is the pyramid from the eye through the polygon's edges, cut off at the polygon. Made in eye space in
//! f64, moved into the frame where bounds are stored, then rounded; kept are those that hide most of the view.

use glam::{DAffine3, DVec3, DVec4, Vec4};

use super::view::View;
use crate::scene::{ConvexPlanarOccluder, Page, Scene};

/// Occluders used at once; those with the largest solid angle.
const MOST: usize = 16;
/// Corners nearer to the eye's plane are cut off, metres.
const NEAREST_M: f64 = 1e-3;

/// Planes of all volumes, in eye space; inside is where all of a volume's are positive.
#[derive(Debug, Default)]
pub(super) struct Occluders {
    planes: Vec<DVec4>,
    volumes: Vec<Volume>,
    /// Scratch: a polygon before and after clipping.
    corners: [Vec<DVec3>; 2],
}

#[derive(Clone, Copy, Debug)]
struct Volume {
    /// First plane; the polygon's plane comes first.
    first: u32,
    end: u32,
    /// Ranges of planes of holes follow: `holes` of them, each as a volume without the polygon's plane.
    holes: u32,
    /// Size on a sphere around the eye, roughly.
    solid_angle: f64,
}

/// The same in another frame, as f32.
#[derive(Debug, Default)]
pub(super) struct FrameOccluders {
    planes: Vec<Vec4>,
}

impl Occluders {
    pub fn clear(&mut self) {
        self.planes.clear();
        self.volumes.clear();
    }

    pub fn is_empty(&self) -> bool {
        self.volumes.is_empty()
    }

    /// Takes the occluders of the root pages that a view's masks and switches let through.
    pub fn collect(&mut self, scene: &Scene, view: &View) {
        for root in scene.roots() {
            let Some(page) = scene.page(*root) else { continue };
            for (node, transform, occluder) in &page.occluders {
                if is_shown(page, *node, view.settings.cull_mask) {
                    let eye_from_node = view.eye_from_world * page.transforms.page_from_node(*transform);
                    self.add(&eye_from_node, occluder);
                }
            }
        }
    }

    fn add(&mut self, eye_from_node: &DAffine3, occluder: &ConvexPlanarOccluder) {
        let start = (self.planes.len(), self.volumes.len());
        let Some(solid_angle) = self.add_pyramid(eye_from_node, &occluder.corners, true) else { return };
        self.volumes[start.1].solid_angle = solid_angle;
        for hole in &occluder.holes {
            if self.add_pyramid(eye_from_node, hole, false).is_some() {
                self.volumes[start.1].holes += 1;
            }
        }
        let mains = self.volumes.iter().filter(|v| v.solid_angle > 0.0).count();
        if mains > MOST {
            self.drop_smallest();
        }
    }

    /// Adds the planes of a polygon as a volume; `None` (and nothing added) where it hides nothing.
    fn add_pyramid(&mut self, eye_from_node: &DAffine3, corners: &[DVec3], with_own_plane: bool) -> Option<f64> {
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
        if clipped.len() < 3 || clipped.iter().any(|c| !c.is_finite()) {
            return None;
        }
        let middle = clipped.iter().sum::<DVec3>() / clipped.len() as f64;
        let around = (0..clipped.len()).map(|i| (clipped[i], clipped[(i + 1) % clipped.len()]));
        let normal = around.clone().map(|(a, b)| (a - middle).cross(b - middle)).sum::<DVec3>();
        let area = 0.5 * normal.length();
        let normal = normal.try_normalize()?;
        let facing = normal.dot(middle);
        if facing.abs() < 1e-9 * middle.length() {
            return None; // seen edge-on
        }
        let first = self.planes.len() as u32;
        if with_own_plane {
            // Behind the polygon.
            let away = normal * facing.signum();
            self.planes.push(away.extend(-away.dot(middle)));
        }
        for (a, b) in around {
            let side = a.cross(b);
            if let Some(side) = side.try_normalize() {
                let inward = if side.dot(middle) < 0.0 { -side } else { side };
                self.planes.push(inward.extend(0.0));
            }
        }
        let end = self.planes.len() as u32;
        self.volumes.push(Volume { first, end, holes: 0, solid_angle: 0.0 });
        Some(area * facing.abs() / middle.length().powi(3))
    }

    /// Forgets the smallest volume and its holes; its planes stay unused until the next frame.
    fn drop_smallest(&mut self) {
        let mains = self.volumes.iter().enumerate().filter(|(_, v)| v.solid_angle > 0.0);
        let smallest = mains.min_by(|a, b| a.1.solid_angle.total_cmp(&b.1.solid_angle)).map(|(i, v)| (i, v.holes));
        if let Some((index, holes)) = smallest {
            self.volumes.drain(index..=index + holes as usize);
        }
    }

    /// The planes in the frame of `eye_from_frame`, relative to a point of it.
    pub fn in_frame(&self, eye_from_frame: &DAffine3, origin: DVec3, into: &mut FrameOccluders) {
        into.planes.clear();
        let to_frame = eye_from_frame.matrix3.transpose();
        let origin_in_eye = eye_from_frame.transform_point3(origin);
        into.planes.extend(self.planes.iter().map(|p| {
            let normal = to_frame * p.truncate();
            let length = normal.length();
            let d = p.truncate().dot(origin_in_eye) + p.w;
            let plane = (normal / length).extend(d / length);
            // What cannot be said hides nothing.
            if length > 0.0 && plane.is_finite() { plane.as_vec4() } else { Vec4::new(0.0, 0.0, 0.0, f32::MIN) }
        }));
    }

    /// True when a bound lies wholly in the shadow of one occluder and is not seen through its holes. `reach` is how
    /// far the bound extends along a direction.
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

/// No mask or switch above a node hides it.
fn is_shown(page: &Page, node: u32, cull_mask: u32) -> bool {
    page.path_to_root(node).all(|(node, child)| {
        let seen = page.masks.get(node as usize).unwrap_or(&u32::MAX) & cull_mask != 0;
        seen && child.is_none_or(|child| page.switch_shows(node, child))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn square(half: f64, z: f64) -> Vec<DVec3> {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x * half, y * half, z)).into()
    }

    fn hides(occluder: &ConvexPlanarOccluder, center: DVec3, radius: f32) -> bool {
        let mut occluders = Occluders::default();
        occluders.add(&DAffine3::IDENTITY, occluder);
        let mut frame = FrameOccluders::default();
        occluders.in_frame(&DAffine3::IDENTITY, DVec3::ZERO, &mut frame);
        occluders.hide(&frame, center.as_vec3().to_array(), |_| radius)
    }

    #[test]
    fn what_is_behind_is_hidden_and_what_is_in_a_hole_is_not() {
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
        let nonsense = ConvexPlanarOccluder { corners: vec![DVec3::NAN; 4], holes: vec![] };
        assert!(!hides(&nonsense, at(0.0, -20.0), 1.0));
    }

    #[test]
    fn only_the_largest_are_used() {
        let mut occluders = Occluders::default();
        for i in 0..40 {
            let occluder = ConvexPlanarOccluder { corners: square(1.0 + f64::from(i), -100.0), holes: vec![] };
            occluders.add(&DAffine3::IDENTITY, &occluder);
        }
        assert_eq!(occluders.volumes.len(), MOST);
        let smallest = occluders.volumes.iter().map(|v| v.solid_angle).fold(f64::INFINITY, f64::min);
        assert!(smallest > 4.0 * 24.0 * 24.0 / 1e4 * 0.9, "{smallest}");
    }

    proptest! {
        #[test]
        fn nothing_hidden_has_a_free_ray(
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
                // Every point of the ball is behind the triangle: the ray to it meets the triangle first.
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
