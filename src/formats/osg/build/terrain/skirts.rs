//! Finds the tiles that VirtualPlanetBuilder writes as polygons: a sheet of ground with a skirt.

use glam::DVec3;

use crate::scene::{Mesh, MeshVertex};

/// Returns true for a mesh of which every triangle is ground that faces up, or a part of a skirt below its edge. Vertices of a
/// skirt have the normals and texture coordinates of those above them, so that both are alike along vertical edges.
///
/// A pixel between such a tile and its neighbour can show the skirt from behind, where a material with two sides turns the
/// normal down and away from the light. OSG does not turn it. Nothing else of such a tile is seen from behind.
pub(in super::super) fn is_ground_with_skirt(mesh: &Mesh) -> bool {
    /// The cosine of the angle by which the vertical of a large tile may turn from edge to edge.
    const MIN_PARALLEL: f64 = 0.98;
    let triangles =
        || mesh.indices.as_chunks::<3>().0.iter().map(|triangle| triangle.map(|i| &mesh.vertices[i as usize]));
    let Some(up) = triangles().find_map(vertical_of) else { return false };
    let mut has_ground = false;
    for triangle in triangles() {
        if let Some(vertical) = vertical_of(triangle) {
            if vertical.dot(up) < MIN_PARALLEL {
                return false;
            }
            continue;
        }
        let [a, b, c] = triangle.map(|vertex| DVec3::from_array(vertex.position.map(f64::from)));
        let Some(face) = (b - a).cross(c - b).try_normalize() else { continue };
        if face.dot(up) <= 0.0 || triangle.iter().any(|vertex| normal_of(vertex).dot(up) <= 0.0) {
            return false;
        }
        has_ground = true;
    }
    has_ground
}

fn normal_of(vertex: &MeshVertex) -> DVec3 {
    let [x, y, z, _] = vertex.normal;
    DVec3::new(x.into(), y.into(), z.into())
}

/// Returns the direction upwards of a triangle's edge along which normals and texture coordinates are alike; `None` if it has
/// none.
fn vertical_of(triangle: [&MeshVertex; 3]) -> Option<DVec3> {
    let [a, b, c] = triangle;
    let is_alike = |from: &MeshVertex, to: &MeshVertex| from.normal == to.normal && from.uv == to.uv;
    let mut edges = [[a, b], [b, c], [c, a]].into_iter().filter(|[from, to]| is_alike(from, to));
    edges.find_map(|[from, to]| {
        let [from_m, to_m] = [from, to].map(|vertex| DVec3::from_array(vertex.position.map(f64::from)));
        let along = (to_m - from_m).try_normalize()?;
        Some(if along.dot(normal_of(from)) < 0.0 { -along } else { along })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Aabb;
    use crate::scene::Topology;

    #[test]
    fn tiles_with_skirts_differ_from_houses_and_sheets() {
        let vertex = |x: f32, y: f32, z: f32| MeshVertex {
            position: [x, y, z],
            uv: [x / 100.0, y / 100.0],
            normal: [0, 90, 90, 0],
            color: [255; 4],
        };
        let corners = [(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)];
        let upper: Vec<_> = corners.iter().map(|(x, y)| vertex(*x, *y, -*y)).collect();
        let all: Vec<_> = upper.iter().copied().chain(corners.iter().map(|(x, y)| vertex(*x, *y, -*y - 9.0))).collect();
        let ground = [0, 1, 2, 0, 2, 3];
        let skirt = (0..4u32).flat_map(|side| {
            let next = (side + 1) % 4;
            [side, side + 4, next + 4, side, next + 4, next]
        });
        let indices: Vec<u32> = ground.into_iter().chain(skirt).collect();
        let mesh = |vertices: &[MeshVertex], indices: &[u32]| {
            is_ground_with_skirt(&Mesh::new(vertices.to_vec(), indices.to_vec(), Topology::Triangles))
        };
        assert!(mesh(&all, &indices), "a slope of 45 degrees");
        assert!(!mesh(&upper, &ground), "no skirt");
        assert!(!mesh(&all, &indices[6..]), "no ground");
        let mut turned = indices.clone();
        turned.swap(0, 1);
        assert!(!mesh(&all, &turned), "ground that faces down");
        // The colours of a palette are alike in every direction.
        let palette: Vec<_> = all.iter().map(|vertex| MeshVertex { uv: [0.5; 2], ..*vertex }).collect();
        assert!(!mesh(&palette, &indices));
        let house = Mesh::cuboid(&Aabb { min: DVec3::ZERO, max: DVec3::ONE });
        assert!(!is_ground_with_skirt(&house) && !is_ground_with_skirt(&Mesh::default()));
    }
}
