//! Simple shapes for applications, tests and overlays; OSG's `ShapeDrawable`. Any thread; not frame-time code.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::DVec3;

use super::mesh::{Mesh, MeshVertex, Topology};
use super::shape::Geometry;
use crate::math::Aabb;

fn vertex(position: DVec3, normal: DVec3, uv: [f32; 2]) -> MeshVertex {
    let [x, y, z] = normal.to_array().map(|n| (n * 127.0).round() as i8);
    MeshVertex { position: position.as_vec3().to_array(), uv, normal: [x, y, z, 0], color: [255; 4] }
}

impl Mesh {
    /// Creates a mesh with the box around its vertices.
    pub fn new(vertices: Vec<MeshVertex>, indices: Vec<u32>, topology: Topology) -> Self {
        let bounds = Aabb::from_points(vertices.iter().map(|v| DVec3::from_array(v.position.map(f64::from))));
        Self { vertices, indices: indices.into(), topology, bounds, ..Self::default() }
    }

    /// Creates a rectangle from a corner along two edges. It faces `right x up`, with an upright texture.
    pub fn rectangle(corner: DVec3, right: DVec3, up: DVec3) -> Self {
        let normal = right.cross(up).normalize_or(DVec3::Z);
        let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let at = |(s, t): (f64, f64)| vertex(corner + s * right + t * up, normal, [s as f32, 1.0 - t as f32]);
        Self::new(corners.map(at).to_vec(), vec![0, 1, 2, 0, 2, 3], Topology::Triangles)
    }

    /// Creates a box with flat faces, each with the whole texture.
    pub fn cuboid(bounds: &Aabb) -> Self {
        let (center, half) = (bounds.center(), bounds.half_size());
        let mut all = (Vec::new(), Vec::new());
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            for side in [1.0, -1.0] {
                let normal = side * axis;
                // The texture is upright on the sides.
                let up = if axis == DVec3::Z { DVec3::Y } else { DVec3::Z };
                let (right, up) = (up.cross(normal) * half * 2.0, up * half * 2.0);
                let face = Self::rectangle(center + normal * half - 0.5 * (right + up), right, up);
                let first = all.0.len() as u32;
                all.0.extend(face.vertices);
                all.1.extend(face.indices.iter().map(|i| first + i));
            }
        }
        Self::new(all.0, all.1, Topology::Triangles)
    }

    /// Creates a sphere with a number of segments around (at least 3) and half as many from pole to pole.
    pub fn sphere(center: DVec3, radius_m: f64, segments: u32) -> Self {
        let around = segments.clamp(3, 1024);
        let down = (around / 2).max(2);
        let row = around + 1;
        let mut vertices = Vec::new();
        let mut indices = Vec::new();
        for j in 0..=down {
            for i in 0..=around {
                let (s, t) = (f64::from(i) / f64::from(around), f64::from(j) / f64::from(down));
                let (azimuth, polar) = (TAU * s, PI * t);
                let normal = DVec3::new(polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos());
                vertices.push(vertex(center + radius_m * normal, normal, [s as f32, t as f32]));
                if i < around && j < down {
                    let at = j * row + i;
                    indices.extend([at, at + row, at + row + 1, at, at + row + 1, at + 1]);
                }
            }
        }
        Self::new(vertices, indices, Topology::Triangles)
    }

    /// Creates line segments between consecutive points.
    pub fn polyline(points: &[DVec3]) -> Self {
        let vertices = points.iter().map(|p| vertex(*p, DVec3::ZERO, [0.0; 2])).collect();
        let indices = (1..points.len() as u32).flat_map(|i| [i - 1, i]).collect();
        Self::new(vertices, indices, Topology::Lines)
    }
}

impl From<Mesh> for Geometry {
    fn from(mesh: Mesh) -> Self {
        Self::Mesh(Arc::new(mesh))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the volume that the triangles enclose; positive if all face outwards.
    fn volume(mesh: &Mesh) -> f64 {
        let at = |i: u32| DVec3::from_array(mesh.vertices[i as usize].position.map(f64::from));
        mesh.indices.chunks_exact(3).map(|t| at(t[0]).dot(at(t[1]).cross(at(t[2])))).sum::<f64>() / 6.0
    }

    #[test]
    fn faces_point_outwards() {
        let bounds = Aabb { min: DVec3::new(-1.0, -2.0, -0.5), max: DVec3::new(1.0, 2.0, 1.5) };
        let cuboid = Mesh::cuboid(&bounds);
        assert!((volume(&cuboid) - 16.0).abs() < 1e-6);
        assert_eq!(cuboid.bounds, bounds);
        let sphere = Mesh::sphere(DVec3::ZERO, 2.0, 64);
        let exact = 4.0 / 3.0 * PI * 8.0;
        assert!((volume(&sphere) / exact - 1.0).abs() < 0.01, "{}", volume(&sphere));
        for mesh in [&cuboid, &sphere] {
            for t in mesh.indices.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|k| mesh.vertices[t[k] as usize]);
                let p = |v: MeshVertex| DVec3::from_array(v.position.map(f64::from));
                let facet = (p(b) - p(a)).cross(p(c) - p(a));
                let normal = DVec3::from_array([0, 1, 2].map(|k| f64::from(a.normal[k])));
                assert!(facet.length() < 1e-9 || facet.dot(normal) > 0.0);
            }
        }
        assert_eq!(Mesh::polyline(&[DVec3::ZERO, DVec3::X, DVec3::Y]).indices[..], [0, 1, 1, 2]);
        assert!(Mesh::sphere(DVec3::ZERO, 1.0, 0).indices.len() >= 12);
    }

    #[test]
    fn cones_of_normals_hold_all_faces() {
        let bounds = Aabb { min: DVec3::NEG_ONE, max: DVec3::ONE };
        assert!(Mesh::cuboid(&bounds).normal_cone().is_none(), "faces all around");
        let cone = Mesh::rectangle(DVec3::ZERO, DVec3::X, DVec3::Y).normal_cone().expect("one face");
        assert!(cone.normal.distance(DVec3::Z) < 1e-9 && cone.radius_m > 0.7);
        // Culled from behind, not from the side or the front.
        let culled = |eye: DVec3| {
            let to_eye = eye - cone.control_point;
            to_eye.length() > cone.radius_m && to_eye.normalize().dot(cone.normal) < cone.min_cosine
        };
        assert!(culled(DVec3::new(0.0, 0.0, -10.0)));
        assert!(!culled(DVec3::new(0.0, 0.0, 10.0)) && !culled(DVec3::new(10.0, 0.0, -0.1)));
    }
}
