//! Surfaces as meshes: vertices on an ellipsoid relative to the middle of the tile, normals and skirts. Decode threads.

use std::f64::consts::FRAC_PI_2;

use glam::{DVec3, Vec3};

use super::surface::{Normals, Surface};
use super::tiling::Rectangle;
use crate::math::{Aabb, Ellipsoid, Geodetic};
use crate::scene::{Mesh, MeshVertex};

/// Sides of triangles that are shorter count as points, metres.
const MIN_SIDE_M: f64 = 1e-6;

/// Builds the mesh of a surface over a rectangle of an ellipsoid. Returns the position of its origin, ECEF metres; its axes are
/// those of ECEF. Texture coordinates are shares of the rectangle, from its upper left corner. A skirt of `skirt_m` metres
/// hangs from each edge: neighbours of other levels have other vertices there.
pub(super) fn build(ellipsoid: &Ellipsoid, surface: &Surface, rectangle: &Rectangle, skirt_m: f64) -> (DVec3, Mesh) {
    let [low, high] = surface.heights_m();
    let middle = rectangle.region(*ellipsoid, [low, high]).center();
    let origin = ellipsoid.ecef(&middle);
    let places: Vec<Geodetic> = surface
        .vertices
        .iter()
        .map(|vertex| Geodetic {
            longitude: rectangle.west + (rectangle.east - rectangle.west) * vertex.u,
            latitude: rectangle.south + (rectangle.north - rectangle.south) * vertex.v,
            height_m: vertex.height_m,
        })
        .collect();
    let positions: Vec<DVec3> = places.iter().map(|place| ellipsoid.ecef(place) - origin).collect();
    // All vertices at a pole are one point, but for rounding.
    let is_flat = |triangle: [u32; 3]| {
        let [a, b, c] = triangle.map(|i| positions[i as usize]);
        [(a, b), (b, c), (c, a)].iter().any(|(a, b)| a.distance_squared(*b) < MIN_SIDE_M * MIN_SIDE_M)
    };
    let triangles: Vec<[u32; 3]> = surface.triangles.iter().copied().filter(|triangle| !is_flat(*triangle)).collect();
    let normals = normals(ellipsoid, surface, &places, &positions, &triangles);
    let vertex = |i: usize| MeshVertex {
        position: positions[i].as_vec3().to_array(),
        uv: [surface.vertices[i].u as f32, (1.0 - surface.vertices[i].v) as f32],
        normal: snorm8(normals[i]),
        color: [255; 4],
    };
    let mut vertices: Vec<MeshVertex> = (0..positions.len()).map(vertex).collect();
    let mut indices: Vec<u32> = triangles.into_iter().flatten().collect();
    for (number, edge) in surface.edges.iter().enumerate() {
        let parallel = [None, Some(rectangle.south), None, Some(rectangle.north)][number];
        if parallel.is_some_and(|latitude| latitude.abs() >= FRAC_PI_2) {
            continue;
        }
        let mut edge = edge.clone();
        // Counter-clockwise around the tile is north, west, south, east; the skirt is seen from outside.
        let along = |i: &u32| {
            let vertex = &surface.vertices[*i as usize];
            [vertex.v, -vertex.u, -vertex.v, vertex.u][number]
        };
        edge.sort_by(|a, b| along(a).total_cmp(&along(b)));
        edge.dedup();
        let first = vertices.len() as u32;
        for i in edge.iter().map(|i| *i as usize) {
            let lowered = positions[i] - ellipsoid.up(&places[i]) * skirt_m;
            vertices.push(MeshVertex { position: lowered.as_vec3().to_array(), ..vertices[i] });
        }
        for (k, pair) in edge.windows(2).enumerate() {
            let (a, b) = (pair[0], pair[1]);
            let (below_a, below_b) = (first + k as u32, first + k as u32 + 1);
            indices.extend([a, b, below_b, a, below_b, below_a]);
        }
    }
    let bounds = Aabb::from_points(vertices.iter().map(|v| Vec3::from_array(v.position).as_dvec3()));
    (origin, Mesh { vertices, indices: indices.into(), bounds, ..Mesh::default() })
}

/// Returns the normal of each vertex in the axes of ECEF.
fn normals(
    ellipsoid: &Ellipsoid,
    surface: &Surface,
    places: &[Geodetic],
    positions: &[DVec3],
    triangles: &[[u32; 3]],
) -> Vec<Vec3> {
    match surface.normals {
        Normals::Given => surface.vertices.iter().map(|vertex| vertex.normal).collect(),
        Normals::OfEllipsoid => places.iter().map(|place| ellipsoid.up(place).as_vec3()).collect(),
        Normals::Computed => {
            let mut sums = vec![DVec3::ZERO; positions.len()];
            for triangle in triangles {
                let [a, b, c] = triangle.map(|i| positions[i as usize]);
                // Its length is twice the area, which is the weight.
                let normal = (b - a).cross(c - a);
                triangle.iter().for_each(|i| sums[*i as usize] += normal);
            }
            let each = sums.iter().zip(places);
            each.map(|(sum, place)| sum.normalize_or(ellipsoid.up(place)).as_vec3()).collect()
        }
    }
}

fn snorm8(normal: Vec3) -> [i8; 4] {
    let [x, y, z] = normal.to_array().map(|x| (x.clamp(-1.0, 1.0) * 127.0).round() as i8);
    [x, y, z, 0]
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::tiling::Tiling;
    use super::*;
    use crate::formats::implicit::TileCoordinates;
    use crate::math::WGS84;

    fn ellipsoid(tiling: Tiling, tile: TileCoordinates) -> (DVec3, Mesh) {
        build(&WGS84, &Surface::of_ellipsoid(tiling.ellipsoid_segments(&WGS84, tile)), &tiling.rectangle(tile), 100.0)
    }

    /// Returns the corners of each triangle relative to the earth's centre.
    fn triangles(origin: DVec3, mesh: &Mesh) -> Vec<[DVec3; 3]> {
        let at = |i: u32| origin + Vec3::from_array(mesh.vertices[i as usize].position).as_dvec3();
        mesh.indices.chunks_exact(3).map(|t| [at(t[0]), at(t[1]), at(t[2])]).collect()
    }

    #[test]
    fn vertices_lie_on_the_ellipsoid_to_a_millimetre_near_the_ground() {
        for (level, max_error_m) in [(0, 1.0), (8, 0.01), (14, 5e-4), (22, 1e-4)] {
            let tile = TileCoordinates { level, x: (1 << level) / 3, y: (1 << level) / 5 * 4, z: 0 };
            let (origin, mesh) = ellipsoid(Tiling::Geographic, tile);
            let surface: u32 =
                Tiling::Geographic.ellipsoid_segments(&WGS84, tile).map(|parts| parts + 1).iter().product();
            for vertex in &mesh.vertices[..surface as usize] {
                let position = origin + Vec3::from_array(vertex.position).as_dvec3();
                let place = WGS84.geodetic(position);
                assert!(place.height_m.abs() < max_error_m, "level {level}: {} m", place.height_m);
                let rectangle = Tiling::Geographic.rectangle(tile);
                let east_of_west = (place.longitude - rectangle.west + 1e-6).rem_euclid(TAU) - 1e-6;
                let u = east_of_west / (rectangle.east - rectangle.west);
                let v = (place.latitude - rectangle.south) / (rectangle.north - rectangle.south);
                let slack = 1e-4 + 2.0 * max_error_m / (6e6 * (rectangle.north - rectangle.south));
                if place.latitude.abs() < 1.5 {
                    assert!((u as f32 - vertex.uv[0]).abs() < slack as f32, "{level} {u} {:?}", vertex.uv);
                }
                assert!((v as f32 - 1.0 + vertex.uv[1]).abs() < slack as f32, "{level} {v} {:?}", vertex.uv);
            }
        }
    }

    /// Surfaces and skirts are seen from outside, at the poles and at the antimeridian too.
    #[test]
    fn triangles_face_outwards() {
        for tiling in [Tiling::Geographic, Tiling::Mercator, Tiling::NorthCap, Tiling::SouthCap] {
            for level in 0..4 {
                let [columns, rows] = tiling.size(level).map(|count| count as u32);
                for (x, y) in [(0, 0), (columns - 1, rows - 1), (columns / 2, rows / 2)] {
                    let tile = TileCoordinates { level, x, y, z: 0 };
                    let (origin, mesh) = ellipsoid(tiling, tile);
                    let rectangle = tiling.rectangle(tile);
                    let middle = WGS84.ecef(&rectangle.region(WGS84, [0.0; 2]).center());
                    assert!(middle.distance(origin) < 1e-6);
                    let skirt_from: u32 =
                        tiling.ellipsoid_segments(&WGS84, tile).map(|parts| parts + 1).iter().product();
                    for (corners, t) in triangles(origin, &mesh).iter().zip(mesh.indices.chunks_exact(3)) {
                        let [a, b, c] = corners;
                        let normal = (b - a).cross(c - a);
                        let is_skirt = t.iter().any(|i| *i >= skirt_from);
                        let place = WGS84.geodetic((a + b + c) / 3.0);
                        if is_skirt {
                            // Outwards from the middle of the tile, along the surface.
                            assert!(normal.dot(WGS84.up(&place)).abs() < 0.3 * normal.length());
                        } else {
                            assert!(normal.dot(WGS84.up(&place)) > 0.0, "{tiling:?} {tile:?}");
                        }
                        if is_skirt && level >= 2 {
                            assert!(normal.dot(a - middle) > 0.0, "{tiling:?} {tile:?}: a skirt faces inwards");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn computed_normals_are_those_of_the_slope() {
        let tile = TileCoordinates { level: 10, x: 900, y: 700, z: 0 };
        let rectangle = Tiling::Geographic.rectangle(tile);
        let mut surface = Surface::of_ellipsoid([8, 8]);
        surface.normals = Normals::Computed;
        // It rises to the east by half of the distance.
        let latitude = 0.5 * (rectangle.south + rectangle.north);
        let width_m = WGS84.prime_vertical_radius_m(latitude) * latitude.cos() * (rectangle.east - rectangle.west);
        surface.vertices.iter_mut().for_each(|vertex| vertex.height_m = 0.5 * width_m * vertex.u);
        let (_, mesh) = build(&WGS84, &surface, &rectangle, 1.0);
        let middle = &mesh.vertices[4 * 9 + 4];
        let place = rectangle.region(WGS84, [0.0; 2]).center();
        let local = WGS84.ecef_from_enu(&place).matrix3.transpose();
        let normal =
            local * Vec3::new(middle.normal[0].into(), middle.normal[1].into(), middle.normal[2].into()).as_dvec3();
        let slope = -normal.x / normal.z;
        assert!((slope - 0.5).abs() < 0.03 && (normal.y / normal.z).abs() < 0.03, "{normal}");
    }
}
