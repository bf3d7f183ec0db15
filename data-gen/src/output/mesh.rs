//! Builds mesh content: the triangles of a tile with skirts, in the east-north-up frame at the tile's centre.

use glam::{DAffine3, DMat3, DMat4, DVec3};
use terrane::formats::writers::GlbMesh;
use terrane::math::{Geodetic, WGS84};

use super::encoding::Triangles;
use super::tin::Tin;
use crate::pyramid::{Block, CELLS, Extent, TileKey};

/// Returns the transform from the frame of a tile's mesh to ECEF.
pub(crate) fn ecef_from_tile(block: &Block<'_>, key: TileKey) -> DAffine3 {
    let e = block.extent(key);
    let f = block.facts(key);
    let height_m = 0.5 * (f64::from(f.min_height_m) + f64::from(f.max_height_m));
    WGS84.ecef_from_enu(&Geodetic { longitude: 0.5 * (e.west + e.east), latitude: 0.5 * (e.south + e.north), height_m })
}

/// Returns the transform from a tile's mesh to a file whose frame, y up, is the earth's.
pub(crate) fn file_from_tile(block: &Block<'_>, key: TileKey) -> DMat4 {
    // glTF's y axis points up; a quarter turn about x maps it to z.
    let z_up_from_y_up = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y));
    DMat4::from(z_up_from_y_up.inverse() * ecef_from_tile(block, key) * z_up_from_y_up)
}

/// Returns the triangles of a tile with data.
pub(crate) fn triangles(block: &Block<'_>, key: TileKey, kind: Triangles) -> Tin {
    match kind {
        Triangles::Grid => Tin::grid(|i, j| block.triangles(key, i, j)),
        Triangles::Tin => tin(block, key),
    }
}

fn tin(block: &Block<'_>, key: TileKey) -> Tin {
    let cells = (CELLS as i64) << key.level;
    let has_data = |i: i64, j: i64| {
        // Cells beyond the edge belong to neighbours; beyond the edge of the block they repeat the nearest ones. So at borders of voids
        // on such an edge, tiles of two blocks may keep different vertices, within the allowed distance and covered by skirts.
        let [x, y] = [(key.x, i), (key.y, j)].map(|(tile, c)| (i64::from(tile) * CELLS as i64 + c).clamp(0, cells - 1));
        let [(x, i), (y, j)] = [x, y].map(|c| ((c as usize / CELLS) as u32, c as usize % CELLS));
        block.triangles(TileKey { level: key.level, x, y }, i, j)
    };
    let set = block.extent(TileKey::ROOT);
    let curvature_m = |row: i64| curvature_m(&set, cells, i64::from(key.y) * CELLS as i64 + row);
    Tin::of_samples(&|i, j| block.height_m(key, i, j), &curvature_m, Some(&has_data), f64::INFINITY)
}

/// Returns the height in metres by which the earth falls below its tangent plane within one cell eastwards and one northwards at
/// a row of a set with `cells` cells along a side. Tiles that share the row get the same bits.
pub(crate) fn curvature_m(set: &Extent, cells: i64, row: i64) -> [f64; 2] {
    let latitude = set.south + (set.north - set.south) * (row as f64 / cells as f64);
    let [d_lon, d_lat] = [set.east - set.west, set.north - set.south].map(|side| side / cells as f64);
    let radius_m = WGS84.prime_vertical_radius_m(latitude);
    let flatter = 1.0 - WGS84.eccentricity_squared() * latitude.sin().powi(2);
    let meridian_m = radius_m * (1.0 - WGS84.eccentricity_squared()) / flatter;
    [0.5 * radius_m * (latitude.cos() * d_lon).powi(2), 0.5 * meridian_m * d_lat.powi(2)]
}

/// Builds the mesh of triangles of a tile. Skirts hang `skirt_m` down from its edges; `image` is the file of its texture, if it
/// has one. Normals are those of the tile's samples, also where there are fewer vertices.
pub(crate) fn build(
    block: &Block<'_>,
    key: TileKey,
    tin: &Tin,
    skirt_m: f64,
    image: Option<Vec<u8>>,
    quantized: bool,
) -> GlbMesh {
    let e = block.extent(key);
    let tile_from_ecef = ecef_from_tile(block, key).inverse();
    let vertex = |i: i64, j: i64, drop_m: f64| -> DVec3 {
        let g = Geodetic {
            longitude: e.west + (e.east - e.west) * (i as f64 / CELLS as f64),
            latitude: e.south + (e.north - e.south) * (j as f64 / CELLS as f64),
            height_m: f64::from(block.height_m(key, i, j)) - drop_m,
        };
        tile_from_ecef.transform_point3(WGS84.ecef(&g))
    };
    // glTF's y axis points up: x = east, y = up, z = -north.
    let y_up = |v: DVec3| [v.x as f32, v.z as f32, -v.y as f32];
    let mut mesh = GlbMesh { base_color: [1.0; 4], image, quantized, ..GlbMesh::default() };
    for [i, j] in &tin.vertices {
        let (i, j) = (i64::from(*i), i64::from(*j));
        let east = vertex(i + 1, j, 0.0) - vertex(i - 1, j, 0.0);
        let north = vertex(i, j + 1, 0.0) - vertex(i, j - 1, 0.0);
        mesh.positions.push(y_up(vertex(i, j, 0.0)));
        mesh.normals.push(y_up(east.cross(north).normalize_or(DVec3::Z)));
        mesh.uvs.push([i as f32 / CELLS as f32, 1.0 - j as f32 / CELLS as f32]);
    }
    mesh.indices.extend(tin.triangles.as_flattened());
    // A triangle whose edge lies on an edge of the tile has a skirt there. Its front faces outwards.
    let mut bottoms: Vec<Option<u16>> = vec![None; tin.vertices.len()];
    let mut bottom = |top: u16, mesh: &mut GlbMesh| {
        *bottoms[usize::from(top)].get_or_insert_with(|| {
            let [i, j] = tin.vertices[usize::from(top)].map(i64::from);
            mesh.positions.push(y_up(vertex(i, j, skirt_m)));
            mesh.normals.push(mesh.normals[usize::from(top)]);
            mesh.uvs.push(mesh.uvs[usize::from(top)]);
            (mesh.positions.len() - 1) as u16
        })
    };
    for triangle in &tin.triangles {
        for k in 0..3 {
            let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
            let [from, to] = [a, b].map(|top| tin.vertices[usize::from(top)]);
            if (0..2).any(|c| from[c] == to[c] && (from[c] == 0 || usize::from(from[c]) == CELLS)) {
                let (c, d) = (bottom(a, &mut mesh), bottom(b, &mut mesh));
                mesh.indices.extend([a, c, d, a, d, b]);
            }
        }
    }
    mesh.optimize_order();
    mesh
}
