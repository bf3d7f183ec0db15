//! Builds mesh content: the triangles of a tile with skirts, in the east-north-up frame at the tile's centre.

use glam::{DAffine3, DVec3};
use terrane::formats::writers::GlbMesh;
use terrane::math::{Geodetic, WGS84};

use super::encoding::Triangles;
use super::tin::{Surface, Tin, edge_vertices, triangulate};
use crate::pyramid::{Block, CELLS, TileKey};

/// Returns the transform from the frame of a tile's mesh to ECEF.
pub(crate) fn ecef_from_tile(block: &Block<'_>, key: TileKey) -> DAffine3 {
    let e = block.extent(key);
    let f = block.facts(key);
    let height_m = 0.5 * (f64::from(f.min_height_m) + f64::from(f.max_height_m));
    WGS84.ecef_from_enu(&Geodetic { longitude: 0.5 * (e.west + e.east), latitude: 0.5 * (e.south + e.north), height_m })
}

/// Returns the triangles of a tile with data.
pub(crate) fn triangles(block: &Block<'_>, key: TileKey, kind: Triangles) -> Tin {
    match kind {
        Triangles::Grid => grid(block, key),
        Triangles::Tin => tin(block, key),
    }
}

/// Returns two triangles for each cell.
fn grid(block: &Block<'_>, key: TileKey) -> Tin {
    let side = CELLS as u16 + 1;
    let vertices = (0..side).flat_map(|j| (0..side).map(move |i| [i, j])).collect();
    let mut triangles = Vec::with_capacity(2 * CELLS * CELLS);
    for (i, j) in (0..CELLS * CELLS).map(|k| (k % CELLS, k / CELLS)) {
        let at = |di: usize, dj: usize| ((j + dj) * (CELLS + 1) + i + di) as u16;
        let [south_east, north_west] = block.triangles(key, i, j);
        triangles.extend(south_east.then(|| [at(0, 0), at(1, 0), at(1, 1)]));
        triangles.extend(north_west.then(|| [at(0, 0), at(1, 1), at(0, 1)]));
    }
    Tin { vertices, triangles, distance_m: 0.0 }
}

fn tin(block: &Block<'_>, key: TileKey) -> Tin {
    let curvature_m = |row: i64| curvature_m(block, key, row);
    let height_m = |i: i64, j: i64| block.height_m(key, i, j);
    let has_data = |i: i64, j: i64| {
        // Cells beyond the edge belong to neighbours; beyond the edge of the block they repeat the nearest ones. So at borders of voids
        // on such an edge, tiles of two blocks may keep different vertices, within the allowed distance and covered by skirts.
        let cells = (CELLS as i64) << key.level;
        let [x, y] = [(key.x, i), (key.y, j)].map(|(tile, c)| (i64::from(tile) * CELLS as i64 + c).clamp(0, cells - 1));
        let [(x, i), (y, j)] = [x, y].map(|c| ((c as usize / CELLS) as u32, c as usize % CELLS));
        block.triangles(TileKey { level: key.level, x, y }, i, j)
    };
    let surface = Surface::new(CELLS + 1, height_m, curvature_m, Some(&has_data));
    let last = CELLS as i64;
    let edge = |at: fn(i64, i64) -> [i64; 2], curvature_m: f64| {
        let places: Vec<[i64; 2]> = (0..=last).map(|k| at(k, last)).collect();
        let heights_m: Vec<f32> = places.iter().map(|[i, j]| height_m(*i, *j)).collect();
        edge_vertices(&heights_m, curvature_m, |k| surface.is_border(places[k].map(|c| c as i32)))
    };
    let north_m = curvature_m(last / 2)[1];
    let edges = [
        edge(|k, _| [k, 0], curvature_m(0)[0]),
        edge(|k, last| [last, k], north_m),
        edge(|k, last| [k, last], curvature_m(last)[0]),
        edge(|k, _| [0, k], north_m),
    ];
    triangulate(&surface, &edges)
}

/// Returns the height in metres by which the earth falls below its tangent plane within one cell eastwards and one northwards at
/// a row. Tiles that share the row get the same bits.
fn curvature_m(block: &Block<'_>, key: TileKey, row: i64) -> [f64; 2] {
    let set = block.extent(TileKey::ROOT);
    let cells = ((CELLS as u64) << key.level) as f64;
    let from_south = i64::from(key.y) * CELLS as i64 + row;
    let latitude = set.south + (set.north - set.south) * (from_south as f64 / cells);
    let [d_lon, d_lat] = [set.east - set.west, set.north - set.south].map(|side| side / cells);
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
