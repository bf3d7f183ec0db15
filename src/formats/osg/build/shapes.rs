//! Shapes as meshes, with about the tessellation that OSG gives them.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::meshes::UvSet;
use super::{Builder, Meshes};
use crate::formats::osg::objects::{ArrayObject, HeightFieldObject, Profile, ShapeObject};
use crate::math::Aabb;
use crate::math::color::linear_rgba;
use crate::scene::{Mesh, MeshVertex, Topology};

/// The numbers of segments that OSG divides a sphere and a round side into.
const SEGMENTS: u32 = 40;
/// Rows of a hemisphere of a capsule.
const HEMISPHERE_ROWS: u32 = 10;

impl Builder<'_> {
    /// Makes the mesh of a shape.
    pub(super) fn shape(&mut self, shape: &ShapeObject, color: [f32; 4], has_colors: bool, uv_set: UvSet) -> Meshes {
        let mut all = (Vec::new(), Vec::new());
        add(shape, &mut all);
        let (mut vertices, indices) = all;
        if uv_set.is_of_positions() {
            for vertex in &mut vertices {
                vertex.uv = uv_set.mapped(DVec3::from_array(vertex.position.map(f64::from)));
            }
        }
        if has_colors {
            let color = linear_rgba(color).map(|part| (part * 255.0).round() as u8);
            vertices.iter_mut().for_each(|vertex| vertex.color = color);
        }
        if vertices.iter().any(|vertex| !vertex.position.iter().all(|part| part.is_finite())) {
            self.note("OpenSceneGraph: a shape whose size is not finite");
            return Meshes { origin: DVec3::ZERO, meshes: Vec::new() };
        }
        let mesh = Mesh::new(vertices, indices, Topology::Triangles);
        Meshes { origin: DVec3::ZERO, meshes: vec![(Arc::new(mesh), true)] }
    }
}

type Lists = (Vec<MeshVertex>, Vec<u32>);

fn add(shape: &ShapeObject, all: &mut Lists) {
    match shape {
        ShapeObject::Box { center, half_lengths, rotation } => {
            let half = half_lengths.abs();
            let cuboid = Mesh::cuboid(&Aabb { min: -half, max: half });
            let map = DAffine3::from_rotation_translation(*rotation, *center);
            append(all, &cuboid, &map);
        }
        ShapeObject::Sphere { center, radius } => {
            append(all, &Mesh::sphere(*center, radius.abs(), SEGMENTS), &DAffine3::IDENTITY);
        }
        ShapeObject::Round { profile, center, radius, height, rotation } => {
            let outline = outline(*profile, radius.abs(), *height);
            let map = DAffine3::from_rotation_translation(*rotation, *center);
            append(all, &turned(&outline), &map);
        }
        ShapeObject::Triangles { positions, indices } => add_triangles(all, positions, indices),
        ShapeObject::HeightField(field) => add_height_field(all, field),
        ShapeObject::Composite(parts) => parts.iter().for_each(|part| add(part, all)),
    }
}

/// Adds the triangles of a TriangleMesh, those with an index that is out of range left out. Without normals they have those
/// of their facets, as in OSG.
fn add_triangles((vertices, indices): &mut Lists, positions: &ArrayObject, of_triangles: &ArrayObject) {
    let (first, count) = (vertices.len() as u32, positions.count());
    let position = |i| [0, 1, 2].map(|component| positions.get(i, component) as f32);
    vertices.extend((0..count).map(|i| MeshVertex { position: position(i), color: [255; 4], ..MeshVertex::default() }));
    for triangle in 0..of_triangles.count() / 3 {
        let corners = [0, 1, 2].map(|corner| of_triangles.get(3 * triangle + corner, 0));
        if corners.iter().all(|corner| *corner >= 0.0 && *corner < count as f64) {
            indices.extend(corners.map(|corner| first + corner as u32));
        }
    }
}

/// Adds the cells of a HeightField, two triangles each, and its skirts.
fn add_height_field((vertices, indices): &mut Lists, field: &HeightFieldObject) {
    let (columns, rows) = (field.columns, field.rows);
    if columns < 2 || rows < 2 {
        return;
    }
    let vertex = |column: usize, row: usize, lowered: f64| {
        let at = |column: usize, row: usize| field.position(column, row);
        let (west, east) = (at(column.saturating_sub(1), row), at((column + 1).min(columns - 1), row));
        let (south, north) = (at(column, row.saturating_sub(1)), at(column, (row + 1).min(rows - 1)));
        let up = field.rotation * DVec3::Z;
        let normal = (east - west).cross(north - south).normalize_or(up);
        let [x, y, z] = normal.to_array().map(|part| (part * 127.0).round() as i8);
        let position = (at(column, row) - up * lowered).as_vec3().to_array();
        let uv = [column as f32 / (columns - 1) as f32, 1.0 - row as f32 / (rows - 1) as f32];
        MeshVertex { position, uv, normal: [x, y, z, 0], color: [255; 4] }
    };
    let first = vertices.len() as u32;
    vertices.extend(
        (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row))).map(|(c, r)| vertex(c, r, 0.0)),
    );
    let at = |column: usize, row: usize| first + (row * columns + column) as u32;
    for row in 0..rows - 1 {
        for column in 0..columns - 1 {
            let [sw, se] = [at(column, row), at(column + 1, row)];
            let [nw, ne] = [at(column, row + 1), at(column + 1, row + 1)];
            indices.extend([sw, se, ne, sw, ne, nw]);
        }
    }
    if field.skirt_height <= 0.0 {
        return;
    }
    // Counter-clockwise seen from above, so that the skirts face outwards.
    let mut ring: Vec<(usize, usize)> = (0..columns - 1).map(|column| (column, 0)).collect();
    ring.extend((0..rows - 1).map(|row| (columns - 1, row)));
    ring.extend((1..columns).rev().map(|column| (column, rows - 1)));
    ring.extend((1..rows).rev().map(|row| (0, row)));
    let lower = vertices.len() as u32;
    vertices.extend(ring.iter().map(|(column, row)| vertex(*column, *row, field.skirt_height)));
    for (k, (column, row)) in ring.iter().enumerate() {
        let next = (k + 1) % ring.len();
        let [a, b] = [at(*column, *row), at(ring[next].0, ring[next].1)];
        let [below_a, below_b] = [lower + k as u32, lower + next as u32];
        indices.extend([a, below_a, below_b, a, below_b, b]);
    }
}

fn append((vertices, indices): &mut Lists, mesh: &Mesh, map: &DAffine3) {
    let first = vertices.len() as u32;
    let rotation: DMat3 = map.matrix3;
    vertices.extend(mesh.vertices.iter().map(|vertex| {
        let position = map.transform_point3(DVec3::from_array(vertex.position.map(f64::from)));
        let [x, y, z, _] = vertex.normal;
        let normal = rotation * DVec3::from_array([x, y, z].map(|part| f64::from(part) / 127.0));
        let [x, y, z] = normal.to_array().map(|part| (part * 127.0).round() as i8);
        MeshVertex { position: position.as_vec3().to_array(), normal: [x, y, z, 0], ..*vertex }
    }));
    indices.extend(mesh.indices.iter().map(|index| first + index));
}

/// A point of an outline: distance from the axis and height, then the same of the normal.
type OutlinePoint = [f64; 4];

/// Returns the outline of a shape from bottom to top. Two points at the same position make an edge.
fn outline(profile: Profile, radius: f64, height: f64) -> Vec<OutlinePoint> {
    let half = 0.5 * height;
    match profile {
        Profile::Cylinder => vec![
            [0.0, -half, 0.0, -1.0],
            [radius, -half, 0.0, -1.0],
            [radius, -half, 1.0, 0.0],
            [radius, half, 1.0, 0.0],
            [radius, half, 0.0, 1.0],
            [0.0, half, 0.0, 1.0],
        ],
        Profile::Cone => {
            // The centre of a cone is its centre of mass, a quarter of its height above the base.
            let (base, tip) = (-0.25 * height, 0.75 * height);
            let slant = height.hypot(radius).max(f64::MIN_POSITIVE);
            let normal = [height / slant, radius / slant];
            vec![
                [0.0, base, 0.0, -1.0],
                [radius, base, 0.0, -1.0],
                [radius, base, normal[0], normal[1]],
                [0.0, tip, normal[0], normal[1]],
            ]
        }
        Profile::Capsule => {
            let point = |step: u32, at: f64, side: f64| {
                let angle = FRAC_PI_2 * f64::from(step) / f64::from(HEMISPHERE_ROWS);
                [radius * angle.cos(), at + side * radius * angle.sin(), angle.cos(), side * angle.sin()]
            };
            let lower = (0..=HEMISPHERE_ROWS).rev().map(|step| point(step, -half, -1.0));
            lower.chain((0..=HEMISPHERE_ROWS).map(|step| point(step, half, 1.0))).collect()
        }
    }
}

/// Turns an outline around the z axis.
fn turned(outline: &[OutlinePoint]) -> Mesh {
    let row = SEGMENTS + 1;
    let (mut vertices, mut indices) = (Vec::new(), Vec::new());
    for (j, [distance, z, outwards, up]) in (0..).zip(outline) {
        for i in 0..=SEGMENTS {
            let (sin, cos) = (TAU * f64::from(i) / f64::from(SEGMENTS)).sin_cos();
            let position = [distance * cos, distance * sin, *z].map(|part| part as f32);
            let [nx, ny, nz] = [outwards * cos, outwards * sin, *up].map(|part| (part * 127.0).round() as i8);
            let uv = [i as f32 / SEGMENTS as f32, 1.0 - j as f32 / (outline.len() - 1) as f32];
            vertices.push(MeshVertex { position, uv, normal: [nx, ny, nz, 0], color: [255; 4] });
            let is_face = j + 1 < outline.len() as u32 && i < SEGMENTS;
            let has_extent = |next: &OutlinePoint| (next[0], next[1]) != (*distance, *z);
            if is_face && outline.get(j as usize + 1).is_some_and(has_extent) {
                let at: u32 = j * row + i;
                indices.extend([at, at + 1, at + row + 1, at, at + row + 1, at + row]);
            }
        }
    }
    Mesh::new(vertices, indices, Topology::Triangles)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn volume(mesh: &Mesh) -> f64 {
        let at = |i: u32| DVec3::from_array(mesh.vertices[i as usize].position.map(f64::from));
        mesh.indices.chunks_exact(3).map(|t| at(t[0]).dot(at(t[1]).cross(at(t[2])))).sum::<f64>() / 6.0
    }

    #[test]
    fn round_shapes_enclose_their_volume_and_face_outwards() {
        for (profile, exact) in [
            (Profile::Cylinder, PI * 4.0 * 3.0),
            (Profile::Cone, PI * 4.0 * 3.0 / 3.0),
            (Profile::Capsule, PI * 4.0 * 3.0 + 4.0 / 3.0 * PI * 8.0),
        ] {
            let got = volume(&turned(&outline(profile, 2.0, 3.0)));
            assert!((got / exact - 1.0).abs() < 0.02, "{profile:?}: {got} of {exact}");
        }
        let bounds = turned(&outline(Profile::Cone, 2.0, 4.0)).bounds;
        assert_eq!((bounds.min.z, bounds.max.z), (-1.0, 3.0));
    }
}
