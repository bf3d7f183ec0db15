//! Builds mesh content: a tile's grid with skirts, in the east-north-up frame at the tile's centre.

use glam::{DAffine3, DVec3};
use terrane::formats::writers::GlbMesh;
use terrane::math::{Geodetic, WGS84};

use crate::pyramid::{Block, CELLS, TileKey};

/// Returns the transform from the frame of a tile's mesh to ECEF.
pub(crate) fn ecef_from_tile(block: &Block<'_>, key: TileKey) -> DAffine3 {
    let e = block.extent(key);
    let f = block.facts(key);
    let height_m = 0.5 * (f64::from(f.min_height_m) + f64::from(f.max_height_m));
    WGS84.ecef_from_enu(&Geodetic { longitude: 0.5 * (e.west + e.east), latitude: 0.5 * (e.south + e.north), height_m })
}

/// Builds the mesh of a tile, without triangles where there is no data. Skirts hang `skirt_m` down from its edges; `image` is
/// its JPEG texture, if it has one.
pub(crate) fn build(block: &Block<'_>, key: TileKey, skirt_m: f64, image: Option<Vec<u8>>, quantized: bool) -> GlbMesh {
    let e = block.extent(key);
    let tile_from_ecef = ecef_from_tile(block, key).inverse();
    let side = CELLS + 1;
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
    let last = CELLS as i64;
    for j in 0..=last {
        for i in 0..=last {
            let east = vertex(i + 1, j, 0.0) - vertex(i - 1, j, 0.0);
            let north = vertex(i, j + 1, 0.0) - vertex(i, j - 1, 0.0);
            mesh.positions.push(y_up(vertex(i, j, 0.0)));
            mesh.normals.push(y_up(east.cross(north).normalize_or(DVec3::Z)));
            mesh.uvs.push([i as f32 / CELLS as f32, 1.0 - j as f32 / CELLS as f32]);
        }
    }
    let at = |i: usize, j: usize| (j * side + i) as u16;
    for j in 0..CELLS {
        for i in 0..CELLS {
            let (sw, se, nw, ne) = (at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
            let [south_east, north_west] = block.triangles(key, i, j);
            if south_east {
                mesh.indices.extend([sw, se, ne]);
            }
            if north_west {
                mesh.indices.extend([sw, ne, nw]);
            }
        }
    }
    // The edge runs counter-clockwise seen from above, so that the front of the skirt faces outwards.
    let mut ring: Vec<(usize, usize)> = Vec::with_capacity(4 * CELLS);
    ring.extend((0..CELLS).map(|i| (i, 0)));
    ring.extend((0..CELLS).map(|j| (CELLS, j)));
    ring.extend((0..CELLS).map(|i| (CELLS - i, CELLS)));
    ring.extend((0..CELLS).map(|j| (0, CELLS - j)));
    let first = mesh.positions.len();
    for &(i, j) in &ring {
        let top = at(i, j) as usize;
        mesh.positions.push(y_up(vertex(i as i64, j as i64, skirt_m)));
        mesh.normals.push(mesh.normals[top]);
        mesh.uvs.push(mesh.uvs[top]);
    }
    for k in 0..ring.len() {
        let next = (k + 1) % ring.len();
        let (a, b) = (at(ring[k].0, ring[k].1), at(ring[next].0, ring[next].1));
        let (c, d) = ((first + k) as u16, (first + next) as u16);
        // The southern and eastern edges belong to south-eastern triangles, the others to north-western ones.
        let (i, j) = (ring[k].0.min(ring[next].0).min(CELLS - 1), ring[k].1.min(ring[next].1).min(CELLS - 1));
        let [south_east, north_west] = block.triangles(key, i, j);
        let has_data = if k < 2 * CELLS { south_east } else { north_west };
        if has_data {
            mesh.indices.extend([a, c, d, a, d, b]);
        }
    }
    remove_unused(&mut mesh);
    mesh
}

/// Removes the vertices that no triangle uses.
fn remove_unused(mesh: &mut GlbMesh) {
    let mut is_used = vec![false; mesh.positions.len()];
    mesh.indices.iter().for_each(|index| is_used[usize::from(*index)] = true);
    if !is_used.contains(&false) {
        return;
    }
    let mut kept = 0;
    let new: Vec<u16> = is_used
        .iter()
        .map(|used| {
            kept += u16::from(*used);
            kept.saturating_sub(1)
        })
        .collect();
    mesh.indices.iter_mut().for_each(|index| *index = new[usize::from(*index)]);
    let mut used = is_used.iter();
    mesh.positions.retain(|_| used.next() == Some(&true));
    let mut used = is_used.iter();
    mesh.normals.retain(|_| used.next() == Some(&true));
    let mut used = is_used.iter();
    mesh.uvs.retain(|_| used.next() == Some(&true));
}
