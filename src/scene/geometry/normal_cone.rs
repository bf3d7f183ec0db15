//! Cones around the normals of a mesh: back-face culling of whole drawables. Plain values.

use glam::DVec3;

use super::mesh::{Mesh, Topology};

/// A cone around the normals of a drawable's faces. The drawable is culled if the eye can see none of the faces and its state
/// culls back faces; OSG's `ClusterCullingCallback`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalCone {
    /// The centre, in the drawable's frame.
    pub control_point: DVec3,
    /// The mean direction of the faces, of unit length.
    pub normal: DVec3,
    /// The drawable is culled if the cosine between `normal` and the direction to the eye is smaller.
    pub min_cosine: f64,
    /// The distance below which the drawable is never culled, metres.
    pub radius_m: f64,
}

impl NormalCone {
    /// Returns true if all faces look away from an eye in the drawable's frame. Parallel rays have the direction `toward_eye`
    /// to the eye everywhere.
    pub(crate) fn looks_away(&self, eye: DVec3, toward_eye: Option<DVec3>) -> bool {
        if let Some(toward_eye) = toward_eye {
            return toward_eye.dot(self.normal) < self.min_cosine * toward_eye.length();
        }
        let to_eye = eye - self.control_point;
        let distance_m = to_eye.length();
        distance_m > self.radius_m && to_eye.dot(self.normal) < self.min_cosine * distance_m
    }
}

impl Mesh {
    /// Returns the cone around the normals of the triangles; `None` if there are no triangles, or if some normal is 90 degrees
    /// or more from the mean.
    pub fn normal_cone(&self) -> Option<NormalCone> {
        if self.topology != Topology::Triangles {
            return None;
        }
        let corner = |i: u32| self.vertices.get(i as usize).map(|v| DVec3::from_array(v.position.map(f64::from)));
        let faces = || {
            self.indices.chunks_exact(3).filter_map(|t| {
                let (a, b, c) = (corner(t[0])?, corner(t[1])?, corner(t[2])?);
                Some(([a, b, c], (b - a).cross(c - a)))
            })
        };
        let mean = faces().fold(DVec3::ZERO, |sum, (_, n)| sum + n).try_normalize()?;
        let unit = || faces().filter_map(|(corners, n)| Some((corners, n.try_normalize()?)));
        let widest = unit().map(|(_, n)| n.dot(mean)).fold(1.0, f64::min);
        if widest <= 1e-3 {
            return None;
        }
        let control_point = self.bounds.center();
        let distance = |p: DVec3| p.distance(control_point);
        let radius_m = unit().flat_map(|(corners, _)| corners).map(distance).fold(0.0, f64::max);
        // A face looks away from directions more than 90 degrees from its normal. From outside twice the radius, the directions
        // to the eye from a corner and from the centre differ by less than asin(1/2).
        let half_angle = widest.min(1.0).acos();
        let from_middle = 0.5f64.asin();
        Some(NormalCone {
            control_point,
            normal: mean,
            min_cosine: (std::f64::consts::FRAC_PI_2 + half_angle + from_middle).min(std::f64::consts::PI).cos(),
            radius_m: 2.0 * radius_m,
        })
    }
}
