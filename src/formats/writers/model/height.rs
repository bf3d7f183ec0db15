//! Height tiles as meshes: the grid that the vertex shader displaces, with its skirts. Any thread.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use crate::scene::{HeightTile, Mesh, MeshVertex, Topology};

/// The frame of a height tile mirrors the world. This map of a tile's mesh to the tile mirrors it back.
pub(super) fn tile_from_mesh() -> DAffine3 {
    DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0)))
}

/// Returns the mesh of a tile: two triangles a cell, and four skirts of two triangles a side of a cell. Cells with a height
/// that is not finite are left out. [`tile_from_mesh`] maps it to the tile's frame.
pub(super) fn mesh_of(tile: &HeightTile) -> Mesh {
    let side = tile.side;
    let mut grid = Grid { tile, vertices: Vec::new(), indices: Vec::new() };
    for j in 0..side {
        for i in 0..side {
            grid.vertices.push(grid.vertex(i, j, 0.0));
        }
    }
    let at = |i: u32, j: u32| j * side + i;
    for j in 0..side.saturating_sub(1) {
        for i in 0..side - 1 {
            let [sw, se, ne, nw] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            grid.triangle([sw, se, ne]);
            grid.triangle([sw, ne, nw]);
        }
    }
    // Counter-clockwise seen from above, so that the front of the skirts faces outwards.
    let last = side.saturating_sub(1);
    let edges: [Vec<(u32, u32)>; 4] = [
        (0..side).map(|i| (i, 0)).collect(),
        (0..side).map(|j| (last, j)).collect(),
        (0..side).rev().map(|i| (i, last)).collect(),
        (0..side).rev().map(|j| (0, j)).collect(),
    ];
    for edge in edges.iter().filter(|_| tile.skirt_m > 0.0) {
        let first = grid.vertices.len() as u32;
        for (i, j) in edge {
            let lower = grid.vertex(*i, *j, tile.skirt_m);
            grid.vertices.push(lower);
        }
        for (k, pair) in (0..).zip(edge.windows(2)) {
            let [a, b] = [pair[0], pair[1]].map(|(i, j)| at(i, j));
            grid.triangle([a, first + k, first + k + 1]);
            grid.triangle([a, first + k + 1, b]);
        }
    }
    let Grid { mut vertices, indices, .. } = grid;
    // No triangle uses such a vertex, and files hold finite numbers only.
    vertices.iter_mut().filter(|vertex| !is_finite(vertex)).for_each(|vertex| vertex.position = [0.0; 3]);
    Mesh::new(vertices, indices, Topology::Triangles)
}

struct Grid<'a> {
    tile: &'a HeightTile,
    vertices: Vec<MeshVertex>,
    indices: Vec<u32>,
}

impl Grid<'_> {
    /// Returns the vertex of a column and a row, lowered by some metres.
    fn vertex(&self, i: u32, j: u32, lowered_m: f32) -> MeshVertex {
        let tile = self.tile;
        let [dp, dz, cos, sin] = tile.rows[j as usize];
        let [column_sin, versine] = tile.columns[i as usize];
        let height = |di: i64, dj: i64| {
            let at = (i64::from(j) + 1 + dj) * i64::from(tile.side + 2) + i64::from(i) + 1 + di;
            tile.heights[at as usize]
        };
        let h = height(0, 0) - lowered_m;
        // In f64: the distance from the earth's axis is large, and the sine small.
        let p = f64::from(tile.p0_m) + f64::from(dp) + f64::from(h) * f64::from(cos);
        let position = [
            p * f64::from(column_sin),
            -(f64::from(dp) + f64::from(h) * f64::from(cos) - p * f64::from(versine)),
            f64::from(dz) + f64::from(h) * f64::from(sin),
        ];
        // The border samples give the slope at the edges too.
        let [width, depth] = tile.cell_m;
        let slope = |high: f32, low: f32, cell_m: f32| {
            let slope = (high - low) / (2.0 * cell_m);
            if slope.is_finite() { slope } else { 0.0 }
        };
        let (to_east, to_north) =
            (slope(height(1, 0), height(-1, 0), width), slope(height(0, 1), height(0, -1), depth));
        let column_cos = 1.0 - versine;
        let up = Vec3::new(cos * column_sin, -cos * column_cos, sin);
        let east = Vec3::new(column_cos, column_sin, 0.0);
        let north = up.cross(east);
        let normal = (up - east * to_east - north * to_north).normalize_or(up);
        let [x, y, z] = normal.to_array().map(|part| (part * 127.0).round() as i8);
        let cells = (tile.side - 1).max(1) as f32;
        MeshVertex {
            position: position.map(|part| part as f32),
            uv: [i as f32 / cells, 1.0 - j as f32 / cells],
            normal: [x, y, z, 0],
            color: [255; 4],
        }
    }

    fn triangle(&mut self, corners: [u32; 3]) {
        if corners.iter().all(|corner| is_finite(&self.vertices[*corner as usize])) {
            self.indices.extend(corners);
        }
    }
}

fn is_finite(vertex: &MeshVertex) -> bool {
    vertex.position.iter().all(|part| part.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Aabb;

    /// A plane of 3 x 3 samples, 10 m apart, that rises eastwards.
    fn tile() -> HeightTile {
        let p0_m = 1e9;
        HeightTile {
            side: 3,
            heights: (0..25).map(|i| (i % 5) as f32 * 5.0).collect(),
            rows: [-10.0, 0.0, 10.0].map(|north: f32| [-north, 0.0, 0.0, 1.0]).into(),
            columns: [-10.0, 0.0, 10.0].map(|east: f32| [east / p0_m, 0.0]).into(),
            p0_m,
            level: 0,
            coarser_errors_m: Vec::new(),
            skirt_m: 2.0,
            cell_m: [10.0, 10.0],
            texture: None,
            bounds: Aabb::EMPTY,
        }
    }

    #[test]
    fn grid_faces_upwards_with_normals_and_skirts() {
        let mesh = mesh_of(&tile());
        assert_eq!((mesh.vertices.len(), mesh.indices.len() / 3), (9 + 12, 8 + 16));
        let at = |i: u32| Vec3::from_array(mesh.vertices[i as usize].position);
        assert_eq!(at(0), Vec3::new(-10.0, -10.0, 5.0), "the south-western corner, east and north");
        assert_eq!(at(8), Vec3::new(10.0, 10.0, 15.0));
        for triangle in mesh.indices.chunks_exact(3).take(8) {
            let [a, b, c] = [at(triangle[0]), at(triangle[1]), at(triangle[2])];
            assert!((b - a).cross(c - a).z > 0.0);
        }
        let out = mesh.indices.chunks_exact(3).skip(8).all(|triangle| {
            let [a, b, c] = [at(triangle[0]), at(triangle[1]), at(triangle[2])];
            (b - a).cross(c - a).dot((a + b + c) * Vec3::new(1.0, 1.0, 0.0)) > 0.0
        });
        assert!(out, "skirts face outwards");
        let normal = mesh.vertices[4].normal.map(f32::from);
        assert!((normal[0] / normal[2] + 0.5).abs() < 0.02 && normal[1] == 0.0, "{normal:?}");
        assert_eq!(mesh.bounds.min.z, 3.0);
    }

    #[test]
    fn cells_without_a_height_are_left_out() {
        let mut tile = tile();
        tile.heights[6] = f32::NAN;
        let mesh = mesh_of(&tile);
        assert_eq!(mesh.indices.len() / 3, 8 - 2 + 16 - 4);
        assert!(mesh.vertices.iter().all(is_finite));
    }
}
